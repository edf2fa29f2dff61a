//! Candidates of neighbouring columns joined to chains, and the chains that are the stripe.

use super::search::{Candidate, Candidates};

/// Columns that a chain may lack in one place (a hair, a grain of dark speckle); no more than it
/// has points: what stands alone is noise as a rule.
const GAP: usize = 8;

/// What is decided by here, for the report: name and value.
pub(super) fn limits() -> Vec<(&'static str, String)> {
    vec![(
        "stripe, chains: columns that may be missing in a row",
        GAP.to_string(),
    )]
}

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

/// A chain that still grows. Its points stand in a list that all chains share, each with the place
/// of the one before it: most candidates are noise and never become a chain.
struct Open {
    last: Candidate,
    first_u: u16,
    count: u32,
    strength: u64,
    slope: f32,
    place: u32,
}

/// Where a chain's first point has none before it.
const NONE: u32 = u32::MAX;

/// Joins candidates to chains of at least `least` points. Where chains lie over each other
/// (reflections, spots), the strongest keeps the columns.
pub(super) fn chains(candidates: &Candidates, least: usize) -> Vec<Chain> {
    let mut done = Vec::new();
    let mut open: Vec<Open> = Vec::new();
    let mut links: Vec<(Candidate, u32)> = Vec::with_capacity(candidates.list.len());
    let mut used = Vec::new();
    for i in 0..candidates.first.len() - 1 {
        let column = candidates.column(i);
        if column.is_empty() {
            continue;
        }
        let u = column[0].u;
        open.retain(|o| {
            let live = usize::from(u - o.last.u) <= GAP.min(o.count as usize) + 1;
            if !live {
                done.extend(o.close(&links, least));
            }
            live
        });
        // The longest choose first.
        open.sort_by_key(|o| std::cmp::Reverse(o.count));
        used.clear();
        used.resize(column.len(), false);
        for o in &mut open {
            let gap = f32::from(u - o.last.u);
            let expected = f32::from(o.last.v) + o.slope * gap;
            let reach = (2.5 + 0.5 * gap).min(6.0);
            let (mut nearest, mut distance) = (usize::MAX, f32::INFINITY);
            for (k, c) in column.iter().enumerate() {
                let d = (f32::from(c.v) - expected).abs();
                if d < distance && !used[k] {
                    (nearest, distance) = (k, d);
                }
            }
            if distance > reach {
                continue;
            }
            let point = column[nearest];
            used[nearest] = true;
            let step = (f32::from(point.v) - f32::from(o.last.v)) / gap;
            o.slope = (o.slope + 0.2 * (step - o.slope)).clamp(-3.0, 3.0);
            o.strength += u64::from(point.response);
            o.count += 1;
            o.last = point;
            links.push((point, o.place));
            o.place = links.len() as u32 - 1;
        }
        for (c, _) in column.iter().zip(&used).filter(|(_, used)| !**used) {
            links.push((*c, NONE));
            open.push(Open {
                last: *c,
                first_u: c.u,
                count: 1,
                strength: u64::from(c.response),
                slope: 0.0,
                place: links.len() as u32 - 1,
            });
        }
    }
    done.extend(open.iter().filter_map(|o| o.close(&links, least)));
    uppermost(done, least)
}

impl Open {
    /// The chain, if it is long enough and has a point in every other column.
    fn close(&self, links: &[(Candidate, u32)], least: usize) -> Option<Chain> {
        let n = self.count as usize;
        if n < least || 2 * n < usize::from(self.last.u - self.first_u) {
            return None;
        }
        let mut points = Vec::with_capacity(n);
        let mut place = self.place;
        while let Some(&(point, before)) = links.get(place as usize) {
            points.push(point);
            place = before;
        }
        points.reverse();
        Some(Chain {
            points,
            strength: self.strength,
        })
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
