//! Candidates of neighbouring columns joined to chains, and the chains that are the stripe.

use super::search::{Candidate, Candidates};

/// Columns that a chain may lack in one place (a hair, a grain of dark speckle).
const GAP: usize = 8;

/// A run of candidates along the stripe, in ascending columns.
#[derive(Clone, Debug)]
pub(super) struct Chain {
    pub points: Vec<Candidate>,
    /// Sum of the responses.
    pub strength: u64,
}

impl Chain {
    /// Mean response of a point.
    pub(super) fn brightness(&self) -> f32 {
        self.strength as f32 / self.points.len().max(1) as f32
    }

    fn span(&self) -> (u16, u16) {
        (
            self.points.first().map_or(0, |p| p.u),
            self.points.last().map_or(0, |p| p.u),
        )
    }
}

/// A chain that still grows.
struct Open {
    chain: Chain,
    slope: f32,
}

/// Joins candidates to chains of at least `least` points. Where chains lie over each other
/// (reflections, spots), the strongest keeps the columns.
pub(super) fn chains(candidates: &Candidates, least: usize) -> Vec<Chain> {
    let mut done = Vec::new();
    let mut open: Vec<Open> = Vec::new();
    let mut used = Vec::new();
    for i in 0..candidates.first.len() - 1 {
        let column = candidates.column(i);
        if column.is_empty() {
            continue;
        }
        let u = column[0].u;
        open.retain_mut(|o| {
            let live = usize::from(u - o.chain.span().1) <= GAP + 1;
            if !live {
                close(&mut o.chain, least, &mut done);
            }
            live
        });
        // The longest choose first.
        open.sort_by_key(|o| std::cmp::Reverse(o.chain.points.len()));
        used.clear();
        used.resize(column.len(), false);
        for o in &mut open {
            let Some(last) = o.chain.points.last() else {
                continue;
            };
            let gap = f32::from(u - last.u);
            let expected = f32::from(last.v) + o.slope * gap;
            let reach = (2.5 + 0.5 * gap).min(6.0);
            let nearest = column
                .iter()
                .enumerate()
                .filter(|(k, _)| !used[*k])
                .map(|(k, c)| (k, (f32::from(c.v) - expected).abs()))
                .min_by(|a, b| a.1.total_cmp(&b.1));
            let Some((k, distance)) = nearest else {
                continue;
            };
            if distance > reach {
                continue;
            }
            used[k] = true;
            let step = (f32::from(column[k].v) - f32::from(last.v)) / gap;
            o.slope = (o.slope + 0.2 * (step - o.slope)).clamp(-3.0, 3.0);
            o.chain.strength += u64::from(column[k].response);
            o.chain.points.push(column[k]);
        }
        for (k, c) in column.iter().enumerate() {
            if !used[k] {
                open.push(Open {
                    chain: Chain {
                        points: vec![*c],
                        strength: u64::from(c.response),
                    },
                    slope: 0.0,
                });
            }
        }
    }
    for o in &mut open {
        close(&mut o.chain, least, &mut done);
    }
    uppermost(done, least)
}

fn close(chain: &mut Chain, least: usize, done: &mut Vec<Chain>) {
    let n = chain.points.len();
    let (a, b) = chain.span();
    if n >= least && 2 * n >= usize::from(b - a) {
        done.push(Chain {
            points: std::mem::take(&mut chain.points),
            strength: chain.strength,
        });
    }
}

/// One chain a column: the stronger one. What is left of a chain counts if it is long enough and
/// still most of it.
fn uppermost(mut all: Vec<Chain>, least: usize) -> Vec<Chain> {
    all.sort_by_key(|c| std::cmp::Reverse(c.strength));
    let columns = all.iter().map(|c| usize::from(c.span().1) + 1).max();
    let mut taken = vec![false; columns.unwrap_or(0)];
    let mut kept = Vec::new();
    for mut chain in all {
        let before = chain.points.len();
        chain.points.retain(|p| !taken[usize::from(p.u)]);
        if chain.points.len() < least || 2 * chain.points.len() < before {
            continue;
        }
        // A hole in the chain is still its own.
        let (a, b) = chain.span();
        taken[usize::from(a)..=usize::from(b)].fill(true);
        kept.push(chain);
    }
    kept
}
