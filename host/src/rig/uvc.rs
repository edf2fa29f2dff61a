//! A UVC bench camera through Video4Linux: it runs by itself, so the rig stops at each position
//! and takes a frame that began after everything stood still.

use super::camera::{Camera, CameraError, Exposure, Frame, Picture};
use super::config;
use crate::image::Image;
use rustix::time::{ClockId, clock_gettime};
use std::io::ErrorKind;
use std::time::Duration;
use v4l::buffer::{Flags, Type};
use v4l::control::{Control, Value};
use v4l::io::traits::CaptureStream;
use v4l::prelude::MmapStream;
use v4l::video::Capture;
use v4l::{Device, Format, FourCC};

/// Buffers that the driver can fill before one is taken.
const BUFFERS: u32 = 4;
/// V4L2_CID_EXPOSURE_AUTO, where 1 is manual.
const EXPOSURE_AUTO: u32 = 0x009a_0901;
/// V4L2_CID_EXPOSURE_ABSOLUTE, in units of 100 µs.
const EXPOSURE_ABSOLUTE: u32 = 0x009a_0902;

/// A Video4Linux camera.
pub struct UvcCamera {
    device: Device,
    name: String,
    format: Format,
    stream: Option<MmapStream<'static>>,
    /// From the beginning of an exposure to the driver's time stamp at the most, µs.
    before_stamp_us: i64,
    frame_time_us: i64,
    /// The driver stamps by the system's monotonic clock (known from the first frame on).
    monotonic: bool,
}

fn failed(e: std::io::Error) -> CameraError {
    CameraError::Failed(e.to_string())
}

impl UvcCamera {
    /// Opens the device of the configuration ("/dev/video0") for grey images: Mono8 as GREY or YUYV
    /// (whose first channel is grey), Mono16 as Y16.
    ///
    /// # Errors
    /// No such device, or one that does not give that format at that size.
    pub fn open(settings: &config::Camera) -> Result<Self, CameraError> {
        let not_found =
            |e: std::io::Error| CameraError::NotFound(settings.device.clone(), e.to_string());
        let device = Device::with_path(&settings.device).map_err(not_found)?;
        let mut format = device.format().map_err(not_found)?;
        let [_, _, width, height] = settings.region;
        if width > 0 && height > 0 {
            (format.width, format.height) = (width, height);
        }
        let size = (format.width, format.height);
        let mut given = format;
        let wanted = four_letters(&settings.pixel_format);
        for &letters in wanted {
            format.fourcc = FourCC::new(letters);
            (format.width, format.height) = size;
            given = device.set_format(&format).map_err(failed)?;
            if given.fourcc.repr == *letters {
                break;
            }
        }
        agreed(
            &settings.pixel_format,
            wanted,
            size,
            &given.fourcc.repr,
            (given.width, given.height),
        )?;
        let name = device.query_caps().map(|c| c.card).unwrap_or_default();
        Ok(Self {
            device,
            name,
            format: given,
            stream: None,
            before_stamp_us: 0,
            frame_time_us: (1000.0 * settings.frame_time_ms) as i64,
            monotonic: false,
        })
    }
}

/// The formats of Video4Linux that give a pixel format of the configuration, the best one first.
fn four_letters(pixel_format: &str) -> &'static [&'static [u8; 4]] {
    match pixel_format {
        "Mono8" => &[b"GREY", b"YUYV"],
        "Mono16" => &[b"Y16 "],
        _ => &[],
    }
}

/// Whether what the camera gives is what was asked: a driver answers with what it likes better.
fn agreed(
    pixel_format: &str,
    wanted: &[&[u8; 4]],
    size: (u32, u32),
    given: &[u8; 4],
    given_size: (u32, u32),
) -> Result<(), CameraError> {
    if !wanted.contains(&given) {
        return Err(CameraError::Setting {
            key: "camera.pixel_format",
            reason: format!(
                "{pixel_format} was asked for, it gives {}",
                String::from_utf8_lossy(given).trim_end()
            ),
        });
    }
    if size != given_size {
        return Err(CameraError::Setting {
            key: "camera.region",
            reason: format!(
                "{} × {} was asked for, it gives {} × {}; `v4l2-ctl --list-formats-ext` lists its sizes",
                size.0, size.1, given_size.0, given_size.1
            ),
        });
    }
    Ok(())
}

/// Makes grey of a raw frame; `None` if it is too short or of a format that is not read.
fn grey(
    fourcc: &[u8; 4],
    width: usize,
    height: usize,
    stride: usize,
    data: &[u8],
) -> Option<Picture> {
    let bytes = match fourcc {
        b"GREY" => 1,
        b"YUYV" | b"Y16 " => 2,
        _ => return None,
    };
    let stride = stride.max(width * bytes);
    let rows = (0..height).map(|v| data.get(v * stride..v * stride + width * bytes));
    if fourcc == b"Y16 " {
        let mut pixels = Vec::with_capacity(width * height);
        for row in rows {
            pixels.extend(
                row?.chunks_exact(2)
                    .map(|b| u16::from_le_bytes([b[0], b[1]])),
            );
        }
        return Image::from_vec(width, height, pixels).map(Picture::Sixteen);
    }
    let mut pixels = Vec::with_capacity(width * height);
    for row in rows {
        pixels.extend(row?.iter().step_by(bytes));
    }
    Image::from_vec(width, height, pixels).map(Picture::Eight)
}

impl Camera for UvcCamera {
    fn description(&self) -> String {
        self.name.clone()
    }

    fn size(&self) -> (u32, u32) {
        (self.format.width, self.format.height)
    }

    fn arm(&mut self, exposure: &Exposure) -> Result<(), CameraError> {
        self.stream = None;
        let refused = |e: std::io::Error| CameraError::Setting {
            key: "camera.exposure_laser_ms",
            reason: e.to_string(),
        };
        let asked = (exposure.ms * 10.0).round().max(1.0) as i64;
        for (id, value) in [(EXPOSURE_AUTO, 1), (EXPOSURE_ABSOLUTE, asked)] {
            let value = Value::Integer(value);
            self.device
                .set_control(Control { id, value })
                .map_err(refused)?;
        }
        // Drivers clamp without a word.
        let taken = self.device.control(EXPOSURE_ABSOLUTE).map_err(refused)?;
        if let Value::Integer(taken) = taken.value
            && taken != asked
        {
            return Err(CameraError::Setting {
                key: "camera.exposure_laser_ms or camera.exposure_board_ms",
                reason: format!(
                    "{} ms was asked for, it took {} ms",
                    exposure.ms,
                    taken as f64 / 10.0
                ),
            });
        }
        // The stamp is of the first byte's coming, or of the last one's: a frame later.
        self.before_stamp_us = (1000.0 * exposure.ms) as i64 + self.frame_time_us;
        let stream =
            MmapStream::with_buffers(&self.device, Type::VideoCapture, BUFFERS).map_err(failed)?;
        self.stream = Some(stream);
        Ok(())
    }

    fn wait(&mut self, timeout: Duration) -> Result<Option<Frame>, CameraError> {
        let Some(stream) = &mut self.stream else {
            return Err(CameraError::Failed("it is not armed".into()));
        };
        stream.set_timeout(timeout.max(Duration::from_millis(1)));
        let (data, meta) = match stream.next() {
            Ok(frame) => frame,
            Err(e) if matches!(e.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock) => {
                return Ok(None);
            }
            Err(e) => return Err(failed(e)),
        };
        let f = &self.format;
        self.monotonic = meta.flags & Flags::TIMESTAMP_MASK == Flags::TIMESTAMP_MONOTONIC;
        let whole = !meta.flags.contains(Flags::ERROR);
        let data = data.get(..meta.bytesused as usize).unwrap_or(data);
        Ok(Some(Frame {
            sequence: meta.sequence.into(),
            // Seconds are 32 bits wide on some targets.
            #[allow(clippy::unnecessary_cast)]
            time_us: meta.timestamp.sec as i64 * 1_000_000 + meta.timestamp.usec as i64
                - self.before_stamp_us,
            picture: whole
                .then(|| {
                    grey(
                        &f.fourcc.repr,
                        f.width as usize,
                        f.height as usize,
                        f.stride as usize,
                        data,
                    )
                })
                .flatten(),
        }))
    }

    fn clock_us(&mut self) -> Option<i64> {
        let now = clock_gettime(ClockId::Monotonic);
        self.monotonic
            .then(|| now.tv_sec * 1_000_000 + now.tv_nsec / 1000)
    }

    fn disarm(&mut self) -> Result<(), CameraError> {
        self.stream = None;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_format_or_size_than_asked_is_refused() {
        let said = |pixel_format: &str, given: &[u8; 4], size| {
            agreed(
                pixel_format,
                four_letters(pixel_format),
                (1280, 960),
                given,
                size,
            )
            .map_err(|e| e.to_string())
        };
        assert_eq!(said("Mono8", b"GREY", (1280, 960)), Ok(()));
        assert_eq!(said("Mono8", b"YUYV", (1280, 960)), Ok(()));
        assert_eq!(said("Mono16", b"Y16 ", (1280, 960)), Ok(()));
        assert_eq!(
            said("Mono8", b"MJPG", (1280, 960)).unwrap_err(),
            "the camera does not take camera.pixel_format: Mono8 was asked for, it gives MJPG"
        );
        assert!(
            said("Mono16", b"GREY", (1280, 960))
                .unwrap_err()
                .contains("it gives GREY")
        );
        assert!(
            said("Mono8", b"GREY", (1280, 720))
                .unwrap_err()
                .contains("camera.region: 1280 × 960 was asked for, it gives 1280 × 720")
        );
    }

    #[test]
    fn grey_is_taken_out_of_each_format() {
        // Two rows of two pixels, with two bytes of padding a row.
        let yuyv = [10, 128, 20, 128, 0, 0, 30, 128, 40, 128, 0, 0];
        let expected = Image::from_vec(2, 2, vec![10u8, 20, 30, 40]).map(Picture::Eight);
        assert_eq!(grey(b"YUYV", 2, 2, 6, &yuyv), expected);
        assert_eq!(grey(b"GREY", 2, 2, 0, &[10, 20, 30, 40]), expected);
        let wide = Image::from_vec(2, 1, vec![0x0201u16, 0x0403]).map(Picture::Sixteen);
        assert_eq!(grey(b"Y16 ", 2, 1, 4, &[1, 2, 3, 4]), wide);
        // Cut short, or compressed.
        assert_eq!(grey(b"GREY", 2, 2, 2, &[1, 2, 3]), None);
        assert_eq!(grey(b"MJPG", 2, 2, 2, &[0; 99]), None);
    }
}
