//! From single corners to a grid: neighbours along the edges, growth, and places predicted by the
//! grid's homography.
//!
//! Along an edge the dark side changes at each corner: the first axis of one corner is the second
//! axis of the next. That rule keeps a search from skipping a missing corner.

use super::candidate::Candidate;
use crate::geometry::{Homography, Vector2};

/// Corners that belong together, at integer grid coordinates.
#[derive(Clone, Debug)]
pub(super) struct Grid {
    /// ((i, j), candidate).
    pub cells: Vec<((i32, i32), usize)>,
    /// Grid to level pixels.
    pub map: Homography,
}

/// Tangent of the largest angle between an axis and the way to a neighbour.
const NEIGHBOUR_TANGENT: f32 = 0.3;
/// Sine of the largest angle between two axes taken for the same line.
const AXIS_SINE: f32 = 0.42;
/// How far from its predicted place a corner may lie, squares.
const PREDICTION: f64 = 0.3;
/// No board has more squares along a side.
const LARGEST: i32 = 100;

/// What is decided by, for the report: name and value.
pub(super) fn limits() -> Vec<(&'static str, String)> {
    vec![
        (
            "board: largest angle to a neighbour",
            format!("{:.0}°", f64::from(NEIGHBOUR_TANGENT).atan().to_degrees()),
        ),
        (
            "board: largest angle between axes of a line",
            format!("{:.0}°", f64::from(AXIS_SINE).asin().to_degrees()),
        ),
        (
            "board: corner off its predicted place by at most",
            format!("{PREDICTION} squares"),
        ),
    ]
}

const NONE: u32 = u32::MAX;

fn cross(a: [f32; 2], b: [f32; 2]) -> f32 {
    a[0] * b[1] - a[1] * b[0]
}

/// The nearest fitting corner in each of the four directions +axis 0, +axis 1, −axis 0, −axis 1.
fn neighbours(candidates: &[Candidate]) -> Vec<[u32; 4]> {
    let mut all = vec![[NONE; 4]; candidates.len()];
    for (i, c) in candidates.iter().enumerate() {
        let mut best = [f32::INFINITY; 4];
        for (j, other) in candidates.iter().enumerate() {
            let v = [
                other.position[0] - c.position[0],
                other.position[1] - c.position[1],
            ];
            let length2 = v[0] * v[0] + v[1] * v[1];
            if i == j || !(length2 < best[0].max(best[1]).max(best[2]).max(best[3])) {
                continue;
            }
            for axis in 0..2 {
                let along = v[0] * c.axes[axis][0] + v[1] * c.axes[axis][1];
                let across = cross(c.axes[axis], v);
                if across.abs() > NEIGHBOUR_TANGENT * along.abs() {
                    continue;
                }
                let direction = if along > 0.0 { axis } else { axis + 2 };
                let same_line = cross(v, other.axes[1 - axis]).powi(2)
                    < (NEIGHBOUR_TANGENT * NEIGHBOUR_TANGENT) * length2
                    && cross(c.axes[1 - axis], other.axes[axis]).abs() < AXIS_SINE
                    && other.contrast.max(c.contrast) < 4.0 * other.contrast.min(c.contrast);
                if same_line && length2 < best[direction] {
                    best[direction] = length2;
                    all[i][direction] = j as u32;
                }
            }
        }
    }
    all
}

/// All grids of at least four corners in two directions, the largest first.
pub(super) fn find_grids(candidates: &[Candidate]) -> Vec<Grid> {
    let near = neighbours(candidates);
    // The direction in which j leads back to i.
    let back = |i: usize, j: usize| near[j].iter().position(|&k| k as usize == i);
    let mut visited = vec![false; candidates.len()];
    let mut components = Vec::new();
    for seed in 0..candidates.len() {
        if visited[seed] {
            continue;
        }
        visited[seed] = true;
        // (candidate, grid place, how far its own directions are turned against the grid's)
        let mut queue = vec![(seed, (0i32, 0i32), 0usize)];
        let mut next = 0;
        while next < queue.len() {
            let (i, (x, y), turn) = queue[next];
            next += 1;
            for direction in 0..4 {
                let j = near[i][direction];
                if j == NONE || visited[j as usize] {
                    continue;
                }
                let j = j as usize;
                let Some(their) = back(i, j) else { continue };
                let along = (direction + turn) % 4;
                let (dx, dy) = [(1, 0), (0, 1), (-1, 0), (0, -1)][along];
                let place = (x + dx, y + dy);
                if place.0.abs() > LARGEST
                    || place.1.abs() > LARGEST
                    || queue.iter().any(|q| q.1 == place)
                {
                    continue;
                }
                visited[j] = true;
                queue.push((j, place, (along + 2 + 4 - their) % 4));
            }
        }
        if queue.len() >= 4 {
            components.push(queue.iter().map(|q| (q.1, q.0)).collect::<Vec<_>>());
        }
    }
    components.sort_by_key(|c| std::cmp::Reverse(c.len()));
    let mut taken = vec![false; candidates.len()];
    let mut grids = Vec::new();
    for cells in components {
        if cells.iter().any(|c| taken[c.1]) {
            continue; // a larger grid has grown over it
        }
        let Some(map) = fit(&cells, candidates) else {
            continue;
        };
        let mut grid = Grid { cells, map };
        extend(&mut grid, candidates, &taken);
        if grid.cells.len() < 4 {
            continue; // chance neighbours that no homography holds together
        }
        for cell in &grid.cells {
            taken[cell.1] = true;
        }
        grids.push(grid);
    }
    grids.sort_by_key(|g| std::cmp::Reverse(g.cells.len()));
    grids
}

fn position(c: &Candidate) -> Vector2 {
    Vector2::new(f64::from(c.position[0]), f64::from(c.position[1]))
}

fn fit(cells: &[((i32, i32), usize)], candidates: &[Candidate]) -> Option<Homography> {
    let from: Vec<Vector2> = cells
        .iter()
        .map(|c| Vector2::new(f64::from(c.0.0), f64::from(c.0.1)))
        .collect();
    let to: Vec<Vector2> = cells.iter().map(|c| position(&candidates[c.1])).collect();
    Homography::fit(&from, &to).ok()
}

/// The place of grid point (i, j) and the steps to (i + 1, j) and (i, j + 1).
pub(super) fn predict(map: &Homography, i: f64, j: f64) -> (Vector2, Vector2, Vector2) {
    let at = |i: f64, j: f64| map.apply(&Vector2::new(i, j));
    (
        at(i, j),
        at(i + 0.5, j) - at(i - 0.5, j),
        at(i, j + 0.5) - at(i, j - 0.5),
    )
}

/// Smallest and largest grid coordinates: ((i, j), (i, j)).
pub(super) fn bounds(cells: &[((i32, i32), usize)]) -> ((i32, i32), (i32, i32)) {
    cells.iter().fold(
        ((i32::MAX, i32::MAX), (i32::MIN, i32::MIN)),
        |(low, high), &((i, j), _)| ((low.0.min(i), low.1.min(j)), (high.0.max(i), high.1.max(j))),
    )
}

/// Drops corners that do not sit where the others say, and takes in those that do: across a gap
/// that a stripe or a spot tore into the grid.
fn extend(grid: &mut Grid, candidates: &[Candidate], taken: &[bool]) {
    let misplaced = |map: &Homography, place: (i32, i32), c: &Candidate| {
        let (p, ex, ey) = predict(map, f64::from(place.0), f64::from(place.1));
        let allowed = PREDICTION * ex.norm().min(ey.norm());
        !((position(c) - p).norm() < allowed)
    };
    for _ in 0..8 {
        let before = grid.cells.len();
        let map = grid.map;
        grid.cells
            .retain(|&(place, c)| !misplaced(&map, place, &candidates[c]));
        let dropped = before - grid.cells.len();
        if grid.cells.len() < 6 {
            break; // too few to predict from
        }
        let (low, high) = bounds(&grid.cells);
        if high.0 - low.0 > LARGEST || high.1 - low.1 > LARGEST {
            break;
        }
        let columns = (high.0 - low.0 + 3) as usize;
        let rows = (high.1 - low.1 + 3) as usize;
        let mut filled = vec![false; columns * rows];
        let mut used = taken.to_vec();
        let index =
            |(i, j): (i32, i32)| (j - low.1 + 1) as usize * columns + (i - low.0 + 1) as usize;
        for &(place, c) in &grid.cells {
            filled[index(place)] = true;
            used[c] = true;
        }
        let mut added = 0;
        for j in low.1 - 1..=high.1 + 1 {
            for i in low.0 - 1..=high.0 + 1 {
                if filled[index((i, j))] {
                    continue;
                }
                if let Some(c) = nearest_fitting(&map, (i, j), candidates, &used) {
                    grid.cells.push(((i, j), c));
                    used[c] = true;
                    added += 1;
                }
            }
        }
        if added + dropped == 0 {
            break;
        }
        match fit(&grid.cells, candidates) {
            Some(map) => grid.map = map,
            None => break,
        }
    }
}

fn nearest_fitting(
    map: &Homography,
    (i, j): (i32, i32),
    candidates: &[Candidate],
    used: &[bool],
) -> Option<usize> {
    let (p, ex, ey) = predict(map, f64::from(i), f64::from(j));
    let mut best = PREDICTION * ex.norm().min(ey.norm());
    let mut found = None;
    let even = (i + j).rem_euclid(2) == 0;
    for (k, c) in candidates.iter().enumerate() {
        if used[k] {
            continue;
        }
        let distance = (position(c) - p).norm();
        if !(distance < best) {
            continue;
        }
        let along = |axis: [f32; 2], e: &Vector2| {
            let sine = (f64::from(axis[0]) * e.y - f64::from(axis[1]) * e.x) / e.norm();
            sine.abs() < f64::from(AXIS_SINE)
        };
        let (first, second) = if even { (0, 1) } else { (1, 0) };
        if along(c.axes[first], &ex) && along(c.axes[second], &ey) {
            best = distance;
            found = Some(k);
        }
    }
    found
}
