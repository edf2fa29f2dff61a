//! The checkerboard's corners in images, as JSON, to compare with other programs: by the edge model
//! and by orthogonal gradients (`cornerSubPix`), with the seconds that one thread takes.
//!
//! ```text
//! cargo run --release --example corners -- SESSION [IMAGE …]
//! ```
//!
//! Without names of images, all of the session's `camera`.

use anyhow::Context;
use cannula::board::{self, BoardGeometry, subpixel};
use cannula::image::{Image, Pixel};
use cannula::session::{Depth, Session};
use serde_json::{Value, json};
use std::path::Path;
use std::time::Instant;

/// An image is looked at this often; the least time counts.
const REPEAT: usize = 5;

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments.next().context("name a session")?;
    let mut names: Vec<String> = arguments.collect();
    let session = Session::open(Path::new(&folder))?;
    let board: BoardGeometry = session
        .manifest
        .board
        .context("the session describes no board")?
        .into();
    if names.is_empty() {
        names = session
            .manifest
            .camera
            .iter()
            .map(|view| view.image.clone())
            .collect();
    }
    let found: anyhow::Result<Vec<Value>> = names
        .iter()
        .map(|name| {
            Ok(match session.depth {
                Depth::Eight => look(name, &session.luma::<u8>(name)?, &board),
                Depth::Sixteen => look(name, &session.luma::<u16>(name)?, &board),
            })
        })
        .collect();
    println!("{}", Value::from(found?));
    Ok(())
}

fn look<P: Pixel>(name: &str, image: &Image<P>, board: &BoardGeometry) -> Value {
    let mut seconds = f64::INFINITY;
    let mut detection = board::detect(image, board);
    for _ in 0..REPEAT {
        let start = Instant::now();
        detection = board::detect(image, board);
        seconds = seconds.min(start.elapsed().as_secs_f64());
    }
    match detection {
        Ok(found) => {
            let pixels = |at: &dyn Fn(&board::Corner) -> [f64; 2]| -> Vec<[f64; 2]> {
                found.corners.iter().map(at).collect()
            };
            json!({
                "image": name,
                "seconds": seconds,
                "model": pixels(&|c| c.pixel.into()),
                "gradient": pixels(&|c| subpixel::refine(image, c.pixel).into()),
            })
        }
        Err(reason) => json!({
            "image": name,
            "seconds": seconds,
            "reason": reason.to_string(),
        }),
    }
}
