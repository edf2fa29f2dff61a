//! The cloud for other programs: PLY (binary, little-endian), XYZ and CSV.

use super::CloudPoint;
use std::io::{self, BufWriter, Write};

/// Binary PLY with x, y, z (mm), intensity, quality, sigma_mm and frame of each point; `comment`
/// goes into the header (one line). The intensity is a part of the brightest point's, 0 to 1: MeshLab
/// draws it as a grey, and grey values as white.
pub fn write_ply(out: impl Write, points: &[CloudPoint], comment: &str) -> io::Result<()> {
    let mut out = BufWriter::new(out);
    let comment = comment.replace(['\n', '\r'], " ");
    write!(
        out,
        "ply\nformat binary_little_endian 1.0\ncomment {comment}\n\
         comment millimetres, camera frame: x right, y down, z away\n\
         comment intensity: part of the brightest point's\n\
         element vertex {}\n\
         property float x\nproperty float y\nproperty float z\n\
         property float intensity\nproperty float quality\nproperty float sigma_mm\n\
         property int frame\nend_header\n",
        points.len()
    )?;
    let brightest = points.iter().map(|p| p.intensity).fold(0.0, f32::max);
    for p in points {
        let values = [
            p.position.x as f32,
            p.position.y as f32,
            p.position.z as f32,
            p.intensity / brightest.max(f32::MIN_POSITIVE),
            p.quality,
            p.sigma_mm,
        ];
        for v in values {
            out.write_all(&v.to_le_bytes())?;
        }
        out.write_all(&(p.frame as i32).to_le_bytes())?;
    }
    out.flush()
}

/// One line a point: x y z in mm.
pub fn write_xyz(out: impl Write, points: &[CloudPoint]) -> io::Result<()> {
    let mut out = BufWriter::new(out);
    for p in points {
        let q = p.position;
        writeln!(out, "{:.6} {:.6} {:.6}", q.x, q.y, q.z)?;
    }
    out.flush()
}

/// Comma-separated with a header: position (mm), pixel, frame, intensity, quality, sigma (mm).
pub fn write_csv(out: impl Write, points: &[CloudPoint]) -> io::Result<()> {
    let mut out = BufWriter::new(out);
    writeln!(
        out,
        "x_mm,y_mm,z_mm,u_px,v_px,frame,intensity,quality,sigma_mm"
    )?;
    for p in points {
        let (q, c) = (p.position, p.pixel);
        writeln!(
            out,
            "{:.6},{:.6},{:.6},{:.4},{:.4},{},{:.1},{:.3},{:.6}",
            q.x, q.y, q.z, c.x, c.y, p.frame, p.intensity, p.quality, p.sigma_mm
        )?;
    }
    out.flush()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Point3, Vector2, Vector3};

    fn points() -> Vec<CloudPoint> {
        (0..3)
            .map(|i| CloudPoint {
                position: Point3::new(f64::from(i), -2.5, 430.0),
                pixel: Vector2::new(10.0, 20.0),
                frame: i as u32,
                intensity: 25.0 * (i + 2) as f32,
                sigma_mm: 0.02,
                shift: Vector3::z(),
                correlation: 1.0,
                quality: 0.5,
            })
            .collect()
    }

    /// Read back as another program would: by the header's own words.
    #[test]
    fn the_ply_says_what_it_holds() {
        let mut file = Vec::new();
        write_ply(&mut file, &points(), "two\nlines").unwrap();
        let end = b"end_header\n";
        let at = file.windows(end.len()).position(|w| w == end).unwrap() + end.len();
        let header = std::str::from_utf8(&file[..at]).unwrap();
        assert!(header.starts_with("ply\nformat binary_little_endian 1.0\ncomment two lines\n"));
        assert!(header.contains("element vertex 3\n"));
        let properties = header.lines().filter(|l| l.starts_with("property")).count();
        assert_eq!(file.len() - at, 3 * 4 * properties);
        let second = &file[at + 28..];
        let f = |i: usize| f32::from_le_bytes(second[4 * i..4 * i + 4].try_into().unwrap());
        assert_eq!(
            [f(0), f(1), f(2), f(3), f(4)],
            [1.0, -2.5, 430.0, 0.75, 0.5]
        );
        assert_eq!(i32::from_le_bytes(second[24..28].try_into().unwrap()), 1);
    }

    #[test]
    fn text_has_a_line_a_point() {
        let (mut xyz, mut csv) = (Vec::new(), Vec::new());
        write_xyz(&mut xyz, &points()).unwrap();
        write_csv(&mut csv, &points()).unwrap();
        let xyz = String::from_utf8(xyz).unwrap();
        assert_eq!(xyz.lines().nth(1), Some("1.000000 -2.500000 430.000000"));
        let csv = String::from_utf8(csv).unwrap();
        assert_eq!(csv.lines().count(), 4);
        let columns = |l: &str| l.split(',').count();
        assert!(csv.lines().all(|l| columns(l) == 9));
    }
}
