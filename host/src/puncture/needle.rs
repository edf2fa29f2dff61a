//! The needle as a rigid surface y = w over the plane of needle and vein.
//!
//! In the needle's own frame (s behind the tip along the axis, η across it in the plane) the half
//! width is a smooth minimum of the shaft and the bevel,
//!
//! ```text
//! shaft  a = R (1 − (η/R)²)            bevel  b = 2 (s tan β − R − η)
//! w = ½ (a + b − √((a − b)² + ε²))
//! ```
//!
//! The shaft is a lens inscribed in the circle: its slope is at most 2, so that the normal of the
//! contact is smooth and never lies in the plane of symmetry, where it could not cut. The tip is at
//! η = −R (bevel up): a wedge whose half angle is β in both views. Where w ≤ 0 there is no needle.

/// Half width and its derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Width {
    /// w, mm.
    pub w: f64,
    /// ∂w/∂s.
    pub ds: f64,
    /// ∂w/∂η.
    pub de: f64,
}

/// The needle's shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    /// Radius, mm.
    pub radius: f64,
    /// tan of the bevel angle.
    pub tan_bevel: f64,
    /// Rounding of the edge between bevel and shaft, mm.
    pub round: f64,
}

impl Shape {
    /// Of a diameter (mm) and bevel (radians).
    pub fn new(diameter: f64, bevel: f64) -> Self {
        Self {
            radius: 0.5 * diameter,
            tan_bevel: bevel.tan(),
            round: 0.04 * diameter,
        }
    }

    /// Half width at (s, η).
    pub fn width(&self, s: f64, eta: f64) -> Width {
        let r = self.radius;
        let a = r - eta * eta / r;
        let a_de = -2.0 * eta / r;
        let b = 2.0 * (s * self.tan_bevel - r - eta);
        let (b_ds, b_de) = (2.0 * self.tan_bevel, -2.0);
        let d = a - b;
        let root = (d * d + self.round * self.round).sqrt();
        let (ka, kb) = (0.5 * (1.0 - d / root), 0.5 * (1.0 + d / root));
        Width {
            w: 0.5 * (a + b - root),
            ds: kb * b_ds,
            de: ka * a_de + kb * b_de,
        }
    }

    /// Distance to the outline's inside (s ≥ 0, −R ≤ η ≤ min(R, s tan β − R)) and its gradient
    /// (∂/∂s, ∂/∂η). The outline is convex: the distance is smooth outside.
    pub fn distance(&self, s: f64, eta: f64) -> (f64, f64, f64) {
        let r = self.radius;
        // Nearest point of the outline: on the bottom, the bevel, the top, or a corner.
        let norm = (1.0 + self.tan_bevel * self.tan_bevel).sqrt();
        let (c, sn) = (1.0 / norm, self.tan_bevel / norm);
        let heel = 2.0 * r / self.tan_bevel;
        let along = s * c + (eta + r) * sn; // along the bevel from the tip
        let above = -s * sn + (eta + r) * c; // over the bevel
        let inside = eta >= -r && eta <= r && above <= 0.0;
        if inside {
            return (0.0, 0.0, 0.0);
        }
        let near = if eta < -r && s >= 0.0 {
            [s, -r]
        } else if eta > r && s >= heel {
            [s, r]
        } else {
            let k = along.clamp(0.0, heel * norm);
            [k * c, k * sn - r]
        };
        let (ds, de) = (s - near[0], eta - near[1]);
        let d = (ds * ds + de * de).sqrt();
        if d < 1e-12 {
            return (0.0, 0.0, 0.0);
        }
        (d, ds / d, de / d)
    }

    /// Length of the bevel along the axis, mm.
    pub fn bevel_length(&self) -> f64 {
        2.0 * self.radius / self.tan_bevel
    }
}

/// Where the needle is at a moment, and how it moves, in the plane (x along the vein, z up).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Tip (x, z), mm.
    pub tip: [f64; 2],
    /// Angle to the surface, radians.
    pub angle: f64,
    /// Velocity of the tip, mm per step.
    pub velocity: [f64; 2],
    /// Rate of the angle, radians per step (positive: steeper).
    pub turn: f64,
}

impl Placement {
    /// Direction in which the needle points.
    pub fn axis(&self) -> [f64; 2] {
        [self.angle.cos(), -self.angle.sin()]
    }

    /// Across the axis, up.
    pub fn up(&self) -> [f64; 2] {
        [self.angle.sin(), self.angle.cos()]
    }

    /// Velocity of the needle's material at a point, mm per step.
    pub fn velocity_at(&self, p: [f64; 2]) -> [f64; 2] {
        // d(cos a, −sin a)/da = (−sin a, −cos a): a point r turns by (r_z, −r_x) per radian.
        let r = [p[0] - self.tip[0], p[1] - self.tip[1]];
        [
            self.velocity[0] + self.turn * r[1],
            self.velocity[1] - self.turn * r[0],
        ]
    }
}
