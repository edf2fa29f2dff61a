//! Images of a session: 8- or 16-bit PNG or JPEG, grey or RGB, to grey in memory. One image at a
//! time: who works on many does so frame by frame, so that no session is ever held whole.

use super::error::SessionError;
use super::model::Colour;
use crate::image::{Image, Pixel};
use std::path::Path;

/// How deep the images of a session are; one for all, so that stages are compiled for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Depth {
    /// [`Image<u8>`].
    #[default]
    Eight,
    /// [`Image<u16>`]: as soon as one image has 16 bits; 8-bit ones are then scaled by 257.
    Sixteen,
}

/// A decoded image as it stands in the file.
#[derive(Clone, Debug)]
pub struct Raw {
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// 1 (grey) or 3 (RGB).
    channels: usize,
    samples: Samples,
}

#[derive(Clone, Debug)]
enum Samples {
    Eight(Vec<u8>),
    Sixteen(Vec<u16>),
}

/// Size and depth from an image's first bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Bits a sample.
    pub depth: Depth,
}

const PNG_SIGNATURE: &[u8] = b"\x89PNG\r\n\x1a\n";

/// The bytes of an image's file.
pub(super) fn read(path: &Path) -> Result<Vec<u8>, SessionError> {
    // A pipe or a device would block or never end.
    match std::fs::metadata(path) {
        Ok(m) if m.is_file() => {}
        Ok(_) => return Err(broken(path, "is not a file")),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
            return Err(SessionError::MissingImage {
                path: path.to_owned(),
            });
        }
        Err(source) => {
            return Err(SessionError::Io {
                path: path.to_owned(),
                source,
            });
        }
    }
    std::fs::read(path).map_err(|source| SessionError::Io {
        path: path.to_owned(),
        source,
    })
}

fn broken(path: &Path, reason: impl ToString) -> SessionError {
    SessionError::BrokenImage {
        path: path.to_owned(),
        reason: reason.to_string(),
    }
}

/// Reads size and depth of an image without decoding it.
pub fn header(path: &Path) -> Result<Header, SessionError> {
    use std::io::Read;
    let missing = |e: std::io::Error| match e.kind() {
        std::io::ErrorKind::NotFound => SessionError::MissingImage {
            path: path.to_owned(),
        },
        _ => SessionError::Io {
            path: path.to_owned(),
            source: e,
        },
    };
    if !std::fs::metadata(path).map_err(missing)?.is_file() {
        return Err(broken(path, "is not a file"));
    }
    let mut start = Vec::with_capacity(64);
    std::fs::File::open(path)
        .and_then(|f| f.take(29).read_to_end(&mut start))
        .map_err(missing)?;
    if start.is_empty() {
        return Err(broken(path, "the file is empty"));
    }
    if start.starts_with(PNG_SIGNATURE) {
        let word = |at: usize| -> Option<u32> {
            Some(u32::from_be_bytes(start.get(at..at + 4)?.try_into().ok()?))
        };
        return match (word(16), word(20), start.get(24)) {
            (Some(width), Some(height), Some(bits)) if &start[12..16] == b"IHDR" => Ok(Header {
                width,
                height,
                depth: if *bits == 16 {
                    Depth::Sixteen
                } else {
                    Depth::Eight
                },
            }),
            _ => Err(broken(path, "the PNG ends in its header")),
        };
    }
    let (width, height) = image::ImageReader::open(path)
        .and_then(|r| r.with_guessed_format())
        .map_err(missing)?
        .into_dimensions()
        .map_err(|e| broken(path, e))?;
    Ok(Header {
        width,
        height,
        depth: Depth::Eight,
    })
}

/// Reads and decodes an image.
pub fn decode(path: &Path) -> Result<Raw, SessionError> {
    decode_bytes(&read(path)?, path)
}

/// Decodes an image in memory; `path` is for messages only.
pub fn decode_bytes(bytes: &[u8], path: &Path) -> Result<Raw, SessionError> {
    if bytes.starts_with(PNG_SIGNATURE) {
        return decode_png(bytes, path);
    }
    let mut reader = image::ImageReader::new(std::io::Cursor::new(bytes))
        .with_guessed_format()
        .map_err(|e| broken(path, e))?;
    reader.limits(limits());
    if !matches!(reader.format(), Some(image::ImageFormat::Jpeg)) {
        return Err(broken(path, "neither PNG nor JPEG"));
    }
    let decoded = reader.decode().map_err(|e| broken(path, e))?;
    let (width, height) = (decoded.width(), decoded.height());
    let (channels, samples) = match decoded {
        image::DynamicImage::ImageLuma8(i) => (1, i.into_raw()),
        other => (3, other.into_rgb8().into_raw()),
    };
    Ok(Raw {
        width,
        height,
        channels,
        samples: Samples::Eight(samples),
    })
}

fn limits() -> image::Limits {
    let mut limits = image::Limits::default();
    limits.max_alloc = Some(2 << 30);
    limits
}

fn decode_png(bytes: &[u8], path: &Path) -> Result<Raw, SessionError> {
    let mut decoder =
        png::Decoder::new_with_limits(std::io::Cursor::new(bytes), png::Limits { bytes: 2 << 30 });
    decoder.set_transformations(png::Transformations::EXPAND);
    let mut reader = decoder.read_info().map_err(|e| broken(path, e))?;
    let size = reader
        .output_buffer_size()
        .ok_or_else(|| broken(path, "the PNG's size can't be"))?;
    if size > 2 << 30 {
        return Err(broken(path, "the PNG's size can't be"));
    }
    let mut buffer = vec![0; size];
    let info = reader
        .next_frame(&mut buffer)
        .map_err(|e| broken(path, e))?;
    buffer.truncate(info.buffer_size());
    let from = info.color_type.samples();
    let channels = if from >= 3 { 3 } else { 1 };
    let samples = match info.bit_depth {
        png::BitDepth::Sixteen => {
            let (words, _) = buffer.as_chunks::<2>();
            let words = words.iter().map(|w| u16::from_be_bytes(*w)).collect();
            Samples::Sixteen(without_alpha(words, from, channels))
        }
        _ => Samples::Eight(without_alpha(buffer, from, channels)),
    };
    Ok(Raw {
        width: info.width,
        height: info.height,
        channels,
        samples,
    })
}

fn without_alpha<T: Copy>(samples: Vec<T>, from: usize, to: usize) -> Vec<T> {
    if from == to {
        return samples;
    }
    samples
        .chunks_exact(from)
        .flat_map(|p| p[..to].iter().copied())
        .collect()
}

impl Raw {
    /// Brightness (ITU-R BT.601 luma of RGB): what the checkerboard is sought in.
    pub fn luma<P: Pixel>(self) -> Option<Image<P>> {
        self.combine(|p| 0.299 * p[0] + 0.587 * p[1] + 0.114 * p[2])
    }

    /// What the stripe is sought in: the laser's channel over the mean of the two others, where
    /// the image has colours and the laser's is known; brightness otherwise.
    pub fn laser<P: Pixel>(self, colour: Option<Colour>) -> Option<Image<P>> {
        match colour {
            None => self.luma(),
            Some(Colour::Red) => self.combine(|p| p[0] - 0.5 * (p[1] + p[2])),
            Some(Colour::Green) => self.combine(|p| p[1] - 0.5 * (p[0] + p[2])),
            Some(Colour::Blue) => self.combine(|p| p[2] - 0.5 * (p[0] + p[1])),
        }
    }

    /// Whether the image has colours.
    pub fn is_colour(&self) -> bool {
        self.channels == 3
    }

    /// `None` only if the decoder gave another number of samples than it said.
    fn combine<P: Pixel>(self, weigh: impl Fn([f32; 3]) -> f32) -> Option<Image<P>> {
        let (w, h) = (self.width as usize, self.height as usize);
        let pixels = match (self.channels, self.samples) {
            (1, Samples::Eight(v)) => P::from_bytes(v),
            (1, Samples::Sixteen(v)) => P::from_words(v),
            (_, Samples::Eight(v)) => {
                let scale = P::MAX / 255.0;
                v.as_chunks::<3>()
                    .0
                    .iter()
                    .map(|p| P::from_f32(weigh(p.map(f32::from)) * scale))
                    .collect()
            }
            (_, Samples::Sixteen(v)) => {
                let scale = P::MAX / 65535.0;
                v.as_chunks::<3>()
                    .0
                    .iter()
                    .map(|p| P::from_f32(weigh(p.map(f32::from)) * scale))
                    .collect()
            }
        };
        Image::from_vec(w, h, pixels)
    }
}
