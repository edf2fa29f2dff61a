//! Sub-pixel corners by orthogonal gradients, as in OpenCV's `cornerSubPix` (Förstner): the point
//! at which the image gradients around it are most nearly at right angles to the way there. The
//! paper's way; the default is the fitted edge model.

use crate::geometry::{Matrix2, Vector2};
use crate::image::{Image, Pixel};

/// Half the window's side, px (OpenCV's usual 11 × 11 window).
const HALF: i32 = 5;

/// Moves a corner from `start` to the point of orthogonal gradients; `start` itself where the
/// window leaves the image or the iteration leaves the window.
pub fn refine<P: Pixel>(image: &Image<P>, start: Vector2) -> Vector2 {
    let mut at = start;
    for _ in 0..40 {
        let Some(next) = step(image, &at) else {
            return start;
        };
        let moved = (next - at).norm();
        at = next;
        if (at - start).norm() > f64::from(HALF) {
            return start;
        }
        if moved < 1e-3 {
            break;
        }
    }
    at
}

fn step<P: Pixel>(image: &Image<P>, at: &Vector2) -> Option<Vector2> {
    let (w, h) = (image.width() as f64, image.height() as f64);
    let reach = f64::from(HALF) + 2.0;
    if !(at.x >= reach && at.y >= reach && at.x < w - reach && at.y < h - reach) {
        return None;
    }
    let grey = |du: i32, dv: i32| -> f64 {
        let (u, v) = (at.x + f64::from(du), at.y + f64::from(dv));
        let (i, j) = (u.floor(), v.floor());
        let (a, b) = (u - i, v - j);
        let p = |x: usize, y: usize| f64::from(image.at(i as usize + x, j as usize + y).into());
        (1.0 - b) * ((1.0 - a) * p(0, 0) + a * p(1, 0)) + b * ((1.0 - a) * p(0, 1) + a * p(1, 1))
    };
    let mut normal = Matrix2::zeros();
    let mut right = Vector2::zeros();
    for dv in -HALF..=HALF {
        for du in -HALF..=HALF {
            // OpenCV's window weight.
            let (x, y) = (
                f64::from(du) / f64::from(HALF),
                f64::from(dv) / f64::from(HALF),
            );
            let weight = (-x * x - y * y).exp();
            let g = Vector2::new(
                grey(du + 1, dv) - grey(du - 1, dv),
                grey(du, dv + 1) - grey(du, dv - 1),
            );
            let gg = g * g.transpose() * weight;
            normal += gg;
            right += gg * Vector2::new(f64::from(du), f64::from(dv));
        }
    }
    Some(at + normal.try_inverse()? * right)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Four quadrants at an angle, blurred: the truth is where the edges cross.
    fn corner(centre: Vector2) -> Image<u8> {
        let mut image = Image::new(41, 41, 0u8);
        let edge = |d: f64| (d / 0.9).tanh();
        for v in 0..41 {
            for u in 0..41 {
                let d = Vector2::new(u as f64, v as f64) - centre;
                let (a, b) = (d.x * 0.97 + d.y * 0.24, d.y * 0.95 - d.x * 0.31);
                let grey = 128.0 + 80.0 * edge(a) * edge(b);
                image.pixels_mut()[v * 41 + u] = grey.round() as u8;
            }
        }
        image
    }

    #[test]
    fn comes_within_a_few_hundredths_of_a_pixel() {
        for k in 0..10 {
            let truth = Vector2::new(20.0 + 0.1 * k as f64, 20.3 - 0.07 * k as f64);
            let found = refine(&corner(truth), Vector2::new(20.0, 20.0));
            assert!((found - truth).norm() < 0.05, "{found} for {truth}");
        }
    }

    #[test]
    fn stays_where_there_is_no_window() {
        let start = Vector2::new(2.0, 2.0);
        assert_eq!(refine(&corner(Vector2::new(20.0, 20.0)), start), start);
        assert_eq!(
            refine(&Image::new(41, 41, 9u8), Vector2::new(20.0, 20.0)),
            Vector2::new(20.0, 20.0)
        );
    }
}
