//! What is pierced and with what: Table 5's tissues, the layers, the needle, friction and pressure.
//! Everything has a default with its source and can be given in a TOML file.

use super::material::Law;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A tissue: its law, and what it takes to cut it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tissue {
    /// Strain energy (paper, Table 5).
    pub law: Law,
    /// Fracture energy, kJ/m² = N/mm.
    pub toughness_kj_m2: f64,
    /// Peak traction of the cohesive law, MPa.
    pub strength_mpa: f64,
}

/// The layers from the surface down, mm. The vein lies in the fat, along the surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Layers {
    /// Skin.
    pub skin_mm: f64,
    /// Fat between skin and vein.
    pub fat_mm: f64,
    /// Vein wall.
    pub wall_mm: f64,
    /// Diameter of the lumen.
    pub lumen_mm: f64,
}

/// The needle and how it moves.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NeedleSpec {
    /// Outer diameter, mm (22G: 0.72, 24G: 0.55).
    pub diameter_mm: f64,
    /// Angle between bevel and axis, degrees.
    pub bevel_deg: f64,
    /// Speed along the axis, mm/s (paper: 5).
    pub speed_mm_s: f64,
}

/// Everything physical about a puncture.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Setup {
    /// Coulomb friction between needle and tissue (paper: 0.7).
    pub friction: f64,
    /// Pressure in the vein, kPa (paper: 0.7).
    pub pressure_kpa: f64,
    /// Radius of the process zone around the needle's cutting edge, mm (assumed; see cohesive.rs).
    pub process_zone_mm: f64,
    /// Thicknesses.
    pub layers: Layers,
    /// Needle.
    pub needle: NeedleSpec,
    /// Skin.
    #[serde(deserialize_with = "over_skin")]
    pub skin: Tissue,
    /// Subcutaneous fat.
    #[serde(deserialize_with = "over_fat")]
    pub fat: Tissue,
    /// Wall of the vein.
    #[serde(deserialize_with = "over_vein")]
    pub vein: Tissue,
    /// Muscle.
    #[serde(deserialize_with = "over_muscle")]
    pub muscle: Tissue,
}

/// A tissue in a file: what is missing keeps its default.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TissuePart {
    law: Option<Law>,
    toughness_kj_m2: Option<f64>,
    strength_mpa: Option<f64>,
}

/// Reads a tissue over its default.
macro_rules! over {
    ($($name:ident $field:ident),*) => {$(
        fn $name<'de, D: serde::Deserializer<'de>>(d: D) -> Result<Tissue, D::Error> {
            let (part, usual) = (TissuePart::deserialize(d)?, Setup::default().$field);
            Ok(Tissue {
                law: part.law.unwrap_or(usual.law),
                toughness_kj_m2: part.toughness_kj_m2.unwrap_or(usual.toughness_kj_m2),
                strength_mpa: part.strength_mpa.unwrap_or(usual.strength_mpa),
            })
        }
    )*};
}
over!(over_skin skin, over_fat fat, over_vein vein, over_muscle muscle);

/// Why a setup can't be used.
#[derive(Debug, thiserror::Error)]
pub enum SetupError {
    /// The file can't be read.
    #[error("{file}: {cause}")]
    Read {
        /// Which.
        file: String,
        /// Why.
        cause: std::io::Error,
    },
    /// The file is not the TOML that is expected, or a value in it is out of range.
    #[error("{file}: {cause}")]
    Parse {
        /// Which.
        file: String,
        /// What and where.
        cause: String,
    },
    /// A value is out of range.
    #[error("{field}: {problem}")]
    Value {
        /// Which value.
        field: &'static str,
        /// What is wrong and what to do.
        problem: String,
    },
}

impl Default for Layers {
    /// Skin 1.0 and lumen 2.5 mm, wall 0.3 mm: dorsal hand; fat 1.0 mm is assumed.
    fn default() -> Self {
        Self {
            skin_mm: 1.0,
            fat_mm: 1.0,
            wall_mm: 0.3,
            lumen_mm: 2.5,
        }
    }
}

impl Default for NeedleSpec {
    /// 22G with a regular bevel of 12°, at the paper's speed.
    fn default() -> Self {
        Self {
            diameter_mm: 0.72,
            bevel_deg: 12.0,
            speed_mm_s: 5.0,
        }
    }
}

impl Default for Setup {
    /// Table 5; fracture energies 1.1 (skin), 0.3 (vein) kJ/m² from the literature, 0.2 (fat) and
    /// 1.0 (muscle) assumed. Strengths are assumed: they put full separation at an opening of
    /// 0.2 mm, which the mesh can resolve.
    fn default() -> Self {
        Self {
            friction: 0.7,
            pressure_kpa: 0.7,
            process_zone_mm: 0.25,
            layers: Layers::default(),
            needle: NeedleSpec::default(),
            skin: Tissue {
                law: Law::Yeoh {
                    c10: 0.5,
                    c20: -0.06,
                    d1: 0.01,
                    d2: 0.1,
                },
                toughness_kj_m2: 1.1,
                strength_mpa: 11.0,
            },
            fat: Tissue {
                law: Law::MooneyRivlin {
                    c10: 0.1,
                    c01: -0.04,
                    d1: 0.01,
                },
                toughness_kj_m2: 0.2,
                strength_mpa: 2.0,
            },
            vein: Tissue {
                law: Law::Yeoh {
                    c10: 0.4,
                    c20: -0.05,
                    d1: 0.01,
                    d2: 0.12,
                },
                toughness_kj_m2: 0.3,
                strength_mpa: 3.0,
            },
            muscle: Tissue {
                law: Law::MooneyRivlin {
                    c10: 1.0,
                    c01: -0.5,
                    d1: 0.1,
                },
                toughness_kj_m2: 1.0,
                strength_mpa: 10.0,
            },
        }
    }
}

impl Setup {
    /// Reads a TOML file; what is missing in it keeps its default.
    ///
    /// # Errors
    /// The file can't be read or parsed, or a value is out of range.
    pub fn read(file: &Path) -> Result<Self, SetupError> {
        let name = file.display().to_string();
        let text = std::fs::read_to_string(file).map_err(|cause| SetupError::Read {
            file: name.clone(),
            cause,
        })?;
        let setup: Self = toml::from_str(&text).map_err(|e| SetupError::Parse {
            file: name.clone(),
            cause: e.to_string().replace('\n', " "),
        })?;
        match setup.check() {
            Ok(()) => Ok(setup),
            Err(e) => Err(SetupError::Parse {
                file: name,
                cause: e.to_string(),
            }),
        }
    }

    /// Depth of the lumen's roof below the surface, mm.
    pub fn lumen_roof_mm(&self) -> f64 {
        self.layers.skin_mm + self.layers.fat_mm + self.layers.wall_mm
    }

    /// Depth of the lumen's axis below the surface, mm.
    pub fn lumen_axis_mm(&self) -> f64 {
        self.lumen_roof_mm() + 0.5 * self.layers.lumen_mm
    }

    /// The tissues with their names, from the surface down.
    pub fn tissues(&self) -> [(&'static str, Tissue); 4] {
        [
            ("skin", self.skin),
            ("fat", self.fat),
            ("vein", self.vein),
            ("muscle", self.muscle),
        ]
    }

    /// Whether all values are in range.
    ///
    /// # Errors
    /// The first that is not.
    pub fn check(&self) -> Result<(), SetupError> {
        let range = |field, x: f64, low: f64, high: f64| {
            if x.is_finite() && x >= low && x <= high {
                Ok(())
            } else {
                Err(SetupError::Value {
                    field,
                    problem: format!("{x} is outside {low} to {high}"),
                })
            }
        };
        range("friction", self.friction, 0.0, 1.5)?;
        range("pressure_kpa", self.pressure_kpa, 0.0, 20.0)?;
        range("process_zone_mm", self.process_zone_mm, 0.02, 1.0)?;
        range("layers.skin_mm", self.layers.skin_mm, 0.1, 5.0)?;
        range("layers.fat_mm", self.layers.fat_mm, 0.1, 20.0)?;
        range("layers.wall_mm", self.layers.wall_mm, 0.05, 2.0)?;
        range("layers.lumen_mm", self.layers.lumen_mm, 0.3, 10.0)?;
        range("needle.diameter_mm", self.needle.diameter_mm, 0.1, 3.0)?;
        range("needle.bevel_deg", self.needle.bevel_deg, 8.0, 45.0)?;
        range("needle.speed_mm_s", self.needle.speed_mm_s, 0.01, 1000.0)?;
        for (name, tissue) in self.tissues() {
            tissue.law.check().map_err(|problem| SetupError::Value {
                field: name,
                problem,
            })?;
            range(name, tissue.toughness_kj_m2, 0.001, 100.0)?;
            range(name, tissue.strength_mpa, 0.01, 1000.0)?;
        }
        Ok(())
    }

    /// The same with every fracture energy times `k` (the opening at separation grows with it).
    pub fn with_toughness(&self, k: f64) -> Self {
        let mut s = *self;
        for t in [&mut s.skin, &mut s.fat, &mut s.vein, &mut s.muscle] {
            t.toughness_kj_m2 *= k;
        }
        s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Setup, String> {
        let dir = tempfile::tempdir().expect("a folder");
        let file = dir.path().join("hand.toml");
        std::fs::write(&file, text).expect("written");
        Setup::read(&file).map_err(|e| e.to_string())
    }

    #[test]
    fn a_file_gives_its_own_values_and_leaves_the_others() {
        let got = read(
            "friction = 0.3\n[layers]\nskin_mm = 1.4\n[skin]\ntoughness_kj_m2 = 2.0\n\
             strength_mpa = 9.0\n[skin.law]\nmodel = \"yeoh\"\nc10 = 0.6\nc20 = -0.05\n\
             d1 = 0.01\nd2 = 0.1\n",
        );
        let mut expected = Setup {
            friction: 0.3,
            ..Setup::default()
        };
        expected.layers.skin_mm = 1.4;
        expected.skin = Tissue {
            law: Law::Yeoh {
                c10: 0.6,
                c20: -0.05,
                d1: 0.01,
                d2: 0.1,
            },
            toughness_kj_m2: 2.0,
            strength_mpa: 9.0,
        };
        assert_eq!(got, Ok(expected));
        // Part of a tissue only.
        let mut expected = Setup::default();
        expected.vein.toughness_kj_m2 = 0.6;
        assert_eq!(read("[vein]\ntoughness_kj_m2 = 0.6\n"), Ok(expected));
    }

    #[test]
    fn what_is_wrong_in_a_file_is_named_with_the_file() {
        for (text, word) in [
            ("friction = 7\n", "friction: 7 is outside 0 to 1.5"),
            ("frictoin = 0.3\n", "frictoin"),
            ("friction = \"much\"\n", "line 1"),
            ("[layers]\nskin_mm = nan\n", "layers.skin_mm"),
            ("[fat]\nstrenght_mpa = 1\n", "strenght_mpa"),
        ] {
            let said = read(text).expect_err(text);
            assert!(said.contains("hand.toml") && said.contains(word), "{said}");
        }
        let said = Setup::read(Path::new("/nowhere/hand.toml")).map_err(|e| e.to_string());
        assert!(said.is_err_and(|s| s.contains("/nowhere/hand.toml")));
    }
}
