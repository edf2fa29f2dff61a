//! Cohesive law of the crack in the plane of symmetry: bilinear, with damage, in mixed mode.
//!
//! ```text
//! λ² = (y/yc)² + (e/ℓ)²                        yc = Γ/σ
//! S(λ) = Γ λ/λ0  up to λ0, then Γ (1 − λ)/(1 − λ0) up to 1:     ∫ S dλ = Γ/2
//! ```
//! y is the half opening; each half of the model gets Γ/2. e is what the needle's edge severs by
//! itself: its process zone of radius ℓ around the needle's outline in the plane, e = ℓ − distance.
//! A bond is gone when the outline arrives. The potential is one function of both: the traction
//! S y/(λ yc²) on the faces and S e/(λ ℓ²) ∇e on the needle are its gradient, so that cutting an
//! area A takes ΓA whatever the mesh, and no friction multiplies it. A sharp edge is finer than any
//! mesh: without ℓ a brick would have to be stretched open as a whole, and the tissue would be
//! pushed along with the needle for millimetres. Unloading goes back to the origin. Closing
//! (y < 0) is resisted by a spring.

/// A tissue's law, per area of crack.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Law {
    toughness: f64,
    rise: f64,
    yc: f64,
    zone: f64,
    closing: f64,
}

/// Tractions and energies at a point, per area.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pull {
    /// Traction that pulls the face back to the plane, MPa.
    pub traction: f64,
    /// Traction against the needle's edge along ∇e, MPa.
    pub edge: f64,
    /// Energy that would come back, N/mm.
    pub stored: f64,
    /// Energy that is gone, N/mm.
    pub gone: f64,
}

impl Law {
    /// Of a fracture energy Γ (N/mm), a strength σ (MPa), the λ at which the traction peaks, the
    /// radius ℓ of the edge's process zone (mm) and the spring against closing (MPa/mm).
    pub fn new(toughness: f64, strength: f64, rise: f64, zone: f64, closing: f64) -> Self {
        Self {
            toughness,
            rise,
            yc: toughness / strength,
            zone,
            closing,
        }
    }

    /// Largest stiffness against y, MPa/mm.
    pub fn stiffness(&self) -> f64 {
        (self.toughness / (self.rise * self.yc * self.yc)).max(self.closing)
    }

    /// Radius of the edge's process zone, mm.
    pub fn zone(&self) -> f64 {
        self.zone
    }

    /// At half opening `y` and edge `e`, the largest λ ever having been `most` (updated).
    pub fn pull(&self, y: f64, e: f64, most: &mut f64) -> Pull {
        let (open, edge) = (y.max(0.0) / self.yc, e.max(0.0) / self.zone);
        let q = (open * open + edge * edge).sqrt();
        *most = most.max(q);
        let (slope, gone) = if *most <= self.rise {
            (self.toughness / self.rise, 0.0)
        } else {
            let m = most.min(1.0);
            let t = self.toughness * (1.0 - m) / (1.0 - self.rise);
            // Under the curve up to m, less the triangle that would come back.
            let under =
                0.5 * self.toughness * self.rise + 0.5 * (self.toughness + t) * (m - self.rise);
            (t / m, under - 0.5 * t * m)
        };
        let shut = self.closing * y.min(0.0);
        Pull {
            traction: slope * open / self.yc + shut,
            edge: slope * edge / self.zone,
            stored: 0.5 * slope * q * q + 0.5 * shut * y.min(0.0),
            gone,
        }
    }
}
