//! Reads back the PLY that [`super::write_ply`] wrote.

use std::io::{self, BufRead, Read};

/// Positions (mm) of a cloud that this program wrote.
///
/// # Errors
/// Not such a file, or cut off.
pub fn read_ply(input: impl Read) -> io::Result<Vec<[f32; 3]>> {
    let bad = |what: &str| io::Error::new(io::ErrorKind::InvalidData, what.to_owned());
    let mut input = io::BufReader::new(input);
    let (mut count, mut properties, mut line) = (None, Vec::new(), String::new());
    let mut binary = false;
    loop {
        line.clear();
        // A header is short; anything longer is another kind of file.
        if input.by_ref().take(1000).read_line(&mut line)? == 0 {
            return Err(bad("the header has no end: not a PLY file"));
        }
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            ["end_header"] => break,
            ["format", "binary_little_endian", _] => binary = true,
            ["element", "vertex", n] => {
                count = Some(
                    n.parse::<usize>()
                        .map_err(|_| bad("the vertex count is no number"))?,
                );
            }
            ["property", kind @ ("float" | "int"), name] => {
                properties.push((*kind == "float", name.to_string()))
            }
            ["ply"] | ["comment", ..] => {}
            _ => return Err(bad("not a cloud that cannula wrote")),
        }
    }
    let starts = ["x", "y", "z"];
    let ours = binary
        && properties.len() >= 3
        && properties
            .iter()
            .zip(starts)
            .all(|((float, name), want)| *float && name == want);
    let count = count
        .filter(|_| ours)
        .ok_or_else(|| bad("not a cloud that cannula wrote"))?;
    let mut record = vec![0u8; 4 * properties.len()];
    let mut points = Vec::new();
    for _ in 0..count {
        input
            .read_exact(&mut record)
            .map_err(|_| bad("the file is cut off"))?;
        let at = |i: usize| match record.get(4 * i..4 * i + 4) {
            Some(&[a, b, c, d]) => f32::from_le_bytes([a, b, c, d]),
            _ => f32::NAN,
        };
        points.push([at(0), at(1), at(2)]);
    }
    Ok(points)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::{CloudPoint, write_ply};
    use crate::geometry::{Point3, Vector2, Vector3};

    #[test]
    fn a_cloud_comes_back_and_a_cut_one_is_refused() {
        let points: Vec<CloudPoint> = (0..5)
            .map(|i| CloudPoint {
                position: Point3::new(f64::from(i), -2.5, 430.0),
                pixel: Vector2::new(1.0, 2.0),
                frame: 3,
                intensity: 9.0,
                sigma_mm: 0.1,
                shift: Vector3::z(),
                correlation: 1.0,
                quality: 1.0,
            })
            .collect();
        let mut bytes = Vec::new();
        write_ply(&mut bytes, &points, "a test").unwrap();
        let back = read_ply(bytes.as_slice()).unwrap();
        assert_eq!(back.len(), 5);
        assert_eq!(back[4], [4.0, -2.5, 430.0]);
        for end in [0, 10, bytes.len() - 1] {
            assert!(read_ply(&bytes[..end]).is_err());
        }
        assert!(read_ply([b'x'; 5000].as_slice()).is_err());
    }
}
