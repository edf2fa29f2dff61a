//! Light to grey values: exposure, shot and read noise, saturation, quantisation.

use super::profile::Parameters;
use super::random::{NORMAL, NORMAL_ENTRIES, Random};
use super::raster::Light;
use crate::image::Image;

/// Exposes an image. `frame` makes the noise of each frame its own.
pub fn expose(
    light: &Light,
    exposure: f32,
    parameters: &Parameters,
    seed: u64,
    frame: u64,
) -> Image<u8> {
    let table: &[f32; NORMAL_ENTRIES] = &NORMAL;
    let read = parameters.read_noise_dn * parameters.read_noise_dn;
    let (shot, black) = (parameters.shot_dn, parameters.black_dn);
    let mut random = Random::new(seed, 0x5EED_0000_0000 ^ frame);
    let mut out = Image::new(light.width, light.height, 0u8);
    // Five draws of 12 bits from every 64.
    for (pixels, values) in out.pixels_mut().chunks_mut(5).zip(light.values.chunks(5)) {
        let mut bits = random.next_u64();
        for (pixel, &value) in pixels.iter_mut().zip(values) {
            let signal = value * exposure;
            let noise = table[(bits & 0xFFF) as usize] * (read + shot * signal).sqrt();
            bits >>= 12;
            *pixel = (black + signal + noise + 0.5) as u8; // saturates at both ends
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::profile::Profile;

    #[test]
    fn noise_has_the_variance_asked_for() {
        let parameters = Profile::Nominal.parameters();
        for level in [20.0f32, 60.0, 180.0] {
            let light = Light {
                width: 200,
                height: 200,
                values: vec![level; 40_000],
            };
            let image = expose(&light, 1.0, &parameters, 3, 9);
            let n = 40_000.0;
            let mean = image.pixels().iter().map(|&p| f64::from(p)).sum::<f64>() / n;
            let var = image
                .pixels()
                .iter()
                .map(|&p| (f64::from(p) - mean).powi(2))
                .sum::<f64>()
                / n;
            // Quantisation adds 1/12.
            let expected = f64::from(0.42f32.powi(2) + 0.021 * level) + 1.0 / 12.0;
            assert!(
                (mean - f64::from(level) - 5.0).abs() < 0.03,
                "{level}: {mean}"
            );
            assert!(
                (var / expected - 1.0).abs() < 0.05,
                "{level}: {var} against {expected}"
            );
        }
    }

    #[test]
    fn bright_light_saturates() {
        let light = Light {
            width: 10,
            height: 1,
            values: vec![900.0; 10],
        };
        let image = expose(&light, 1.0, &Profile::Hard.parameters(), 3, 9);
        assert!(image.pixels().iter().all(|&p| p == 255));
    }
}
