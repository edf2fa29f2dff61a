//! Writing a recording: session.json whole or not at all, and its images.

use super::check::check;
use super::error::SessionError;
use super::model::Manifest;
use crate::image::{Image, Pixel};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Checks `manifest` and writes it as `session.json` into `folder` (made if it is not there).
/// The file appears whole or not at all. Gives its path.
pub fn write(folder: &Path, manifest: &Manifest) -> Result<PathBuf, SessionError> {
    check(manifest, &folder.join("session.json"))?;
    write_checked(folder, manifest)
}

/// Writes session.json, of a manifest that was checked, with what else may stand in it.
pub(crate) fn write_checked(
    folder: &Path,
    manifest: &impl serde::Serialize,
) -> Result<PathBuf, SessionError> {
    let path = folder.join("session.json");
    let io = |source| SessionError::Io {
        path: path.clone(),
        source,
    };
    std::fs::create_dir_all(folder).map_err(io)?;
    let text = serde_json::to_vec_pretty(manifest).map_err(|e| io(e.into()))?;
    let mut file = tempfile::NamedTempFile::new_in(folder).map_err(io)?;
    file.write_all(&text).map_err(io)?;
    file.as_file().sync_all().map_err(io)?;
    file.persist(&path).map_err(|e| io(e.error))?;
    Ok(path)
}

/// Writes a grey image as PNG (of 8 or 16 bits, as its pixels are), making its folder.
pub fn write_png<P: Pixel>(path: &Path, image: &Image<P>) -> Result<(), SessionError> {
    let io = |source| SessionError::Io {
        path: path.to_owned(),
        source,
    };
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(io)?;
    }
    // In memory first: an encoder on a file writes its end when it is dropped, and would not say
    // that a disk was full.
    let mut bytes = Vec::with_capacity(size_of_val(image.pixels()) / 2);
    let mut encoder = png::Encoder::new(&mut bytes, image.width() as u32, image.height() as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(if P::BITS > 8 {
        png::BitDepth::Sixteen
    } else {
        png::BitDepth::Eight
    });
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header().map_err(|e| io(e.into()))?;
    writer
        .write_image_data(&P::to_be_bytes(image.pixels()))
        .and_then(|()| writer.finish())
        .map_err(|e| io(e.into()))?;
    std::fs::write(path, &bytes).map_err(io)
}
