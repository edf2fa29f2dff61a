//! Repeatable randomness for the simulation: the same seed gives the same recording everywhere.

use std::sync::LazyLock;

/// A SplitMix64 stream (Steele, Lea, Flood 2014).
#[derive(Clone, Debug)]
pub struct Random(u64);

/// One SplitMix64 step: a well-mixed hash of 64 bits.
#[inline]
pub fn mix(value: u64) -> u64 {
    let z = value.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

impl Random {
    /// The stream number `stream` of a seed; streams are independent of each other.
    pub fn new(seed: u64, stream: u64) -> Self {
        Self(mix(
            mix(seed) ^ mix(stream.wrapping_mul(0xD6E8_FEB8_6659_FD93))
        ))
    }

    /// 64 random bits.
    #[inline]
    pub fn next_u64(&mut self) -> u64 {
        let out = mix(self.0);
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        out
    }

    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform in [low, high).
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Normal with mean 0 and standard deviation 1 (Box–Muller).
    pub fn normal(&mut self) -> f64 {
        let r = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        r * (std::f64::consts::TAU * self.unit()).cos()
    }
}

/// How many entries [`NORMAL`] has: 12 random bits choose one.
pub(super) const NORMAL_ENTRIES: usize = 4096;

/// Normal quantiles at the middles of 4096 equal shares of probability, scaled to variance 1: a
/// table look-up gives pixel noise at a nanosecond each. The tails end at ±3.7 σ.
pub(super) static NORMAL: LazyLock<[f32; NORMAL_ENTRIES]> = LazyLock::new(|| {
    let mut table = [0.0f32; NORMAL_ENTRIES];
    let mut square = 0.0;
    for (i, entry) in table.iter_mut().enumerate() {
        let q = quantile((i as f64 + 0.5) / NORMAL_ENTRIES as f64);
        square += q * q;
        *entry = q as f32;
    }
    let scale = (NORMAL_ENTRIES as f64 / square).sqrt() as f32;
    table.iter_mut().for_each(|entry| *entry *= scale);
    table
});

/// Inverse of the normal distribution by bisection (built once, so speed does not matter).
fn quantile(probability: f64) -> f64 {
    let (mut low, mut high) = (-6.0, 6.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if normal_cdf(middle) < probability {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

/// The normal distribution's cumulative function: a blurred step edge seen at distance `t` (in
/// standard deviations of the blur). Abramowitz & Stegun 7.1.26, error below 1e-7.
#[inline]
pub fn normal_cdf(t: f64) -> f64 {
    if t.abs() > 6.0 {
        return if t > 0.0 { 1.0 } else { 0.0 };
    }
    let x = t.abs() * std::f64::consts::FRAC_1_SQRT_2;
    let k = 1.0 / (1.0 + 0.327_591_1 * x);
    let poly = k
        * (0.254_829_592
            + k * (-0.284_496_736
                + k * (1.421_413_741 + k * (-1.453_152_027 + k * 1.061_405_429))));
    let upper = 0.5 * poly * (-x * x).exp();
    if t > 0.0 { 1.0 - upper } else { upper }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_standard_normal() {
        let n = NORMAL_ENTRIES as f64;
        let moment = |p: i32| NORMAL.iter().map(|&x| f64::from(x).powi(p)).sum::<f64>() / n;
        assert!(moment(1).abs() < 1e-6);
        assert!((moment(2) - 1.0).abs() < 1e-5);
        // The fourth moment of a normal is 3; the cut tails take a little away.
        assert!((moment(4) - 3.0).abs() < 0.05, "{}", moment(4));
    }

    #[test]
    fn the_cumulative_function_agrees_with_known_values() {
        for (t, p) in [
            (0.0, 0.5),
            (1.0, 0.841_344_746),
            (-1.96, 0.024_997_895),
            (3.0, 0.998_650_102),
        ] {
            assert!((normal_cdf(t) - p).abs() < 2e-7, "{t}");
        }
    }

    #[test]
    fn streams_differ_and_repeat() {
        let mut a = Random::new(1, 0);
        let mut b = Random::new(1, 1);
        let first = a.next_u64();
        assert_ne!(first, b.next_u64());
        assert_eq!(first, Random::new(1, 0).next_u64());
    }
}
