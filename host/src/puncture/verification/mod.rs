//! Verification of the solver against closed forms and other programs' results.

mod contact;
mod cutting;
mod elements;
mod materials;
mod runs;
mod structures;

use super::explicit::Body;

/// Steps with damping until the residual's motion is gone; `load` adds forces before each step.
fn settle(body: &mut Body, steps: usize, mut load: impl FnMut(&mut Body)) {
    for _ in 0..steps {
        load(body);
        body.internal();
        body.advance();
    }
}
