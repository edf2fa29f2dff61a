//! Thinning to a skeleton one pixel wide (T. Y. Zhang and C. Y. Suen, «A fast parallel algorithm
//! for thinning digital patterns», CACM 27(3), 1984): the paper's «refinement».

use image::GrayImage;

/// The skeleton's pixels (x, y), row by row, of everything in `binary` that is not zero.
pub fn skeleton(binary: &GrayImage) -> Vec<(u32, u32)> {
    let (w, h) = (binary.width() as usize, binary.height() as usize);
    // A frame of background, so that every pixel has eight neighbours.
    let stride = w + 2;
    let mut on = vec![false; stride * (h + 2)];
    let mut active = Vec::new();
    for (x, y, p) in binary.enumerate_pixels() {
        if p.0[0] != 0 {
            let i = (y as usize + 1) * stride + x as usize + 1;
            on[i] = true;
            active.push(i);
        }
    }
    let around = |i: usize| {
        // P2 … P9: north, then clockwise.
        [
            i - stride,
            i - stride + 1,
            i + 1,
            i + stride + 1,
            i + stride,
            i + stride - 1,
            i - 1,
            i - stride - 1,
        ]
    };
    let mut remove = Vec::new();
    loop {
        let mut changed = false;
        for second in [false, true] {
            remove.clear();
            for &i in &active {
                let p = around(i).map(|j| on[j]);
                let count = p.iter().filter(|&&x| x).count();
                let transitions = (0..8).filter(|&k| !p[k] && p[(k + 1) % 8]).count();
                let [n, _, e, _, s, _, w, _] = p;
                let sides = if second {
                    !(n && w && (e || s))
                } else {
                    !(e && s && (n || w))
                };
                if (2..=6).contains(&count) && transitions == 1 && sides {
                    remove.push(i);
                }
            }
            for &i in &remove {
                on[i] = false;
            }
            changed |= !remove.is_empty();
            active.retain(|&i| on[i]);
        }
        if !changed {
            break;
        }
    }
    active
        .iter()
        .map(|&i| ((i % stride - 1) as u32, (i / stride - 1) as u32))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Luma;

    #[test]
    fn a_bar_becomes_a_line_inside_it() {
        let bar = GrayImage::from_fn(40, 15, |x, y| {
            Luma([if (3..37).contains(&x) && (5..10).contains(&y) {
                255
            } else {
                0
            }])
        });
        let line = skeleton(&bar);
        assert!(
            line.len() >= 28 && line.len() <= 34,
            "{} pixels",
            line.len()
        );
        // One pixel wide and near the middle row (7).
        for x in 8..32 {
            let rows: Vec<u32> = line.iter().filter(|p| p.0 == x).map(|p| p.1).collect();
            assert_eq!(rows.len(), 1, "column {x}");
            assert!(rows[0].abs_diff(7) <= 1);
        }
    }

    #[test]
    fn nothing_gives_nothing() {
        assert!(skeleton(&GrayImage::new(0, 0)).is_empty());
        assert!(skeleton(&GrayImage::new(9, 9)).is_empty());
    }
}
