//! A UVC bench camera through Video4Linux: it runs by itself, so the rig stops at each position
//! and takes a frame that began after everything stood still.

use super::camera::{Camera, CameraError, Exposure, Frame, Picture};
use super::config;
use crate::image::Image;
use std::io::ErrorKind;
use std::time::Duration;
use v4l::buffer::Type;
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
}

fn failed(e: std::io::Error) -> CameraError {
    CameraError::Failed(e.to_string())
}

impl UvcCamera {
    /// Opens the device of the configuration ("/dev/video0") in grey, or in YUYV, whose first
    /// channel is grey.
    pub fn open(settings: &config::Camera) -> Result<Self, CameraError> {
        let not_found =
            |e: std::io::Error| CameraError::NotFound(settings.device.clone(), e.to_string());
        let device = Device::with_path(&settings.device).map_err(not_found)?;
        let mut format = device.format().map_err(not_found)?;
        let [_, _, width, height] = settings.region;
        if width > 0 && height > 0 {
            (format.width, format.height) = (width, height);
        }
        for fourcc in [b"GREY", b"Y16 ", b"YUYV"] {
            format.fourcc = FourCC::new(fourcc);
            format = device.set_format(&format).map_err(failed)?;
            if format.fourcc == FourCC::new(fourcc) {
                break;
            }
        }
        let name = device.query_caps().map(|c| c.card).unwrap_or_default();
        Ok(Self {
            device,
            name,
            format,
            stream: None,
        })
    }
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
        for (id, value) in [
            (EXPOSURE_AUTO, 1),
            (
                EXPOSURE_ABSOLUTE,
                (exposure.ms * 10.0).round().max(1.0) as i64,
            ),
        ] {
            let value = Value::Integer(value);
            self.device
                .set_control(Control { id, value })
                .map_err(refused)?;
        }
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
        let data = data.get(..meta.bytesused as usize).unwrap_or(data);
        Ok(Some(Frame {
            sequence: meta.sequence.into(),
            // Seconds are 32 bits wide on some targets.
            #[allow(clippy::unnecessary_cast)]
            time_us: meta.timestamp.sec as i64 * 1_000_000 + meta.timestamp.usec as i64,
            picture: grey(
                &f.fourcc.repr,
                f.width as usize,
                f.height as usize,
                f.stride as usize,
                data,
            ),
        }))
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
