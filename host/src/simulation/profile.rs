//! What kind of recording the simulated rig makes: image size, optics, noise, laser and skin.

use std::str::FromStr;

/// A named set of conditions. [`Profile::parameters`] says what each means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Profile {
    /// 320 × 240 with few images: for tests.
    Tiny,
    /// 1280 × 960, a good camera and a well-chosen exposure.
    Nominal,
    /// 1280 × 960, a noisy soft camera, an overexposed laser, wet and hairy skin.
    Hard,
}

/// The conditions of one profile. Grey values (DN) are of 8-bit images; the unit of exposure is
/// the exposure used for laser images.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameters {
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Focal length about which a seed's camera is drawn, pixels.
    pub focal_px: f64,
    /// Standard deviation of the lens's blur (lowest and highest of the seeds), pixels.
    pub psf_px: (f64, f64),
    /// Images of the board for the camera.
    pub camera_poses: usize,
    /// Poses of the board for the light planes.
    pub light_poses: usize,
    /// Slide positions in each light pose.
    pub light_positions: usize,
    /// Slide positions of the scan (2 mm apart over 60 mm: 31).
    pub scan_positions: usize,
    /// Grey value of no light.
    pub black_dn: f32,
    /// Standard deviation of the noise in the dark, DN.
    pub read_noise_dn: f32,
    /// Variance of the shot noise per grey value above black, DN (the inverse of electrons a DN).
    pub shot_dn: f32,
    /// Grey value above black of a perfectly white surface in ambient light, unit exposure.
    pub ambient_dn: f32,
    /// How much longer board images are exposed than laser images.
    pub board_exposure: f32,
    /// Grey value above black at the middle of the laser's line on a perfectly white surface.
    pub laser_dn: f32,
    /// Standard deviation of the speckle relative to its mean, before the lens blurs it.
    pub speckle_contrast: f32,
    /// Grain of the speckle, pixels.
    pub speckle_grain_px: f64,
    /// How much of that power the laser gives on the board, which reflects more than skin.
    pub board_laser: f32,
    /// Laser light that comes out of the skin beside the line, as a part of what is reflected on it.
    pub glow_share: f32,
    /// Standard deviation of that scattering, mm.
    pub glow_mm: f64,
    /// How much darker veins are than the skin round them (0: not at all).
    pub vein_contrast: f64,
    /// Dark spots on the skin.
    pub spots: usize,
    /// Hairs on the skin.
    pub hairs: usize,
    /// Wet spots that reflect like mirrors.
    pub highlights: usize,
    /// Standard deviation of the slide's position about where its steps put it, mm.
    pub slide_jitter_mm: f64,
}

impl Profile {
    /// All profiles.
    pub const ALL: [Self; 3] = [Self::Tiny, Self::Nominal, Self::Hard];

    /// Its name on the command line and in truth.json.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tiny => "tiny",
            Self::Nominal => "nominal",
            Self::Hard => "hard",
        }
    }

    /// Its conditions.
    pub fn parameters(self) -> Parameters {
        let nominal = Parameters {
            width: 1280,
            height: 960,
            focal_px: 2200.0,
            psf_px: (0.5, 0.62),
            camera_poses: 15,
            light_poses: 9,
            light_positions: 13,
            scan_positions: 31,
            black_dn: 5.0,
            read_noise_dn: 0.42,
            shot_dn: 0.021,
            ambient_dn: 100.0,
            board_exposure: 2.0,
            laser_dn: 280.0,
            board_laser: 0.55,
            speckle_contrast: 0.36,
            speckle_grain_px: 1.2,
            glow_share: 0.6,
            glow_mm: 1.35,
            vein_contrast: 0.3,
            spots: 8,
            hairs: 0,
            highlights: 0,
            slide_jitter_mm: 0.0008,
        };
        match self {
            Self::Nominal => nominal,
            Self::Tiny => Parameters {
                width: 320,
                height: 240,
                focal_px: 550.0,
                camera_poses: 12,
                light_poses: 4,
                light_positions: 7,
                ..nominal
            },
            Self::Hard => Parameters {
                psf_px: (1.0, 1.3),
                read_noise_dn: 1.8,
                shot_dn: 0.05,
                laser_dn: 420.0,
                board_laser: 0.8,
                speckle_contrast: 0.9,
                speckle_grain_px: 1.6,
                glow_share: 0.9,
                glow_mm: 2.0,
                vein_contrast: 0.5,
                spots: 16,
                hairs: 60,
                highlights: 6,
                slide_jitter_mm: 0.003,
                ..nominal
            },
        }
    }
}

impl FromStr for Profile {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        Self::ALL
            .into_iter()
            .find(|profile| profile.name() == name)
            .ok_or_else(|| format!("there is no profile \"{name}\": choose tiny, nominal or hard"))
    }
}

impl std::fmt::Display for Profile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}
