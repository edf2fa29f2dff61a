//! Industrial cameras by GenICam, through aravis.
//!
//! The packet socket is not used (it needs privileges, and does not see the loopback), and the
//! socket's buffer is sized by aravis (`Auto`) when the first packet of a stream comes. A first frame can
//! outrun that, so a new stream is primed with one that nobody needs, and then kept from arming to arming.

use super::camera::{Camera, CameraError, Exposure, Frame, Picture};
use super::config::{self, TriggerSource};
use crate::image::Image;
use aravis::glib::prelude::Cast;
use aravis::prelude::*;
use aravis::{
    AcquisitionMode, Auto, Buffer, BufferStatus, GvStreamOption, GvStreamSocketBuffer, PixelFormat,
    Stream,
};
use std::time::{Duration, Instant};

/// Buffers that the driver can fill before one is taken.
const BUFFERS: usize = 32;
/// How often a frame is asked for to prime a stream, and how long beyond its exposure each is awaited.
const PRIME_TRIES: usize = 3;
const PRIME_TIMEOUT: Duration = Duration::from_millis(300);
/// No camera counts so far. Aravis writes a frame's number and time with its first packet; a buffer whose
/// first packet was lost still shows those of its last use, so that they are marked before it is used.
const UNKNOWN: u64 = u64::MAX;

/// Gives the driver a buffer to fill.
fn give(stream: &Stream, buffer: Buffer) {
    buffer.set_frame_id(UNKNOWN);
    stream.push_buffer(buffer);
}

/// A GenICam camera.
pub struct GenicamCamera {
    camera: aravis::Camera,
    settings: config::Camera,
    description: String,
    size: (u32, u32),
    stream: Option<Stream>,
    armed: bool,
    /// GigE Vision counts frames in 16 bits, 1 to 65535. `None` until the first after arming.
    last_id: Option<u64>,
    sequence: u64,
}

fn failed(e: aravis::glib::Error) -> CameraError {
    CameraError::Failed(e.message().to_owned())
}

fn setting(key: &'static str) -> impl Fn(aravis::glib::Error) -> CameraError {
    move |e| CameraError::Setting {
        key,
        reason: e.message().to_owned(),
    }
}

/// Sets the part of the sensor that is read out, all of it for a size of 0, and gives its width and
/// height. What the camera had before does not matter.
fn set_region(camera: &aravis::Camera, region: [u32; 4]) -> Result<(u32, u32), CameraError> {
    const KEY: &str = "camera.region";
    // Offsets first: sizes are bounded by what they leave.
    for offset in ["OffsetX", "OffsetY"] {
        if camera.is_feature_available(offset).unwrap_or(false) {
            camera.set_integer(offset, 0).map_err(setting(KEY))?;
        }
    }
    let (_, columns) = camera.width_bounds().map_err(setting(KEY))?;
    let (_, rows) = camera.height_bounds().map_err(setting(KEY))?;
    let asked = match region.map(i32::try_from).map(|v| v.unwrap_or(i32::MAX)) {
        [_, _, 0, 0] => [0, 0, columns, rows],
        region => region,
    };
    let [left, top, width, height] = asked;
    if left.saturating_add(width) > columns || top.saturating_add(height) > rows {
        return Err(CameraError::Setting {
            key: KEY,
            reason: format!("{asked:?} reaches beyond its {columns} × {rows} pixels"),
        });
    }
    camera
        .set_region(left, top, width, height)
        .map_err(setting(KEY))?;
    // Some round to what they can do, and say nothing.
    let (left, top, width, height) = camera.region().map_err(failed)?;
    let taken = [left, top, width, height];
    match (u32::try_from(width), u32::try_from(height)) {
        (Ok(width), Ok(height)) if taken == asked => Ok((width, height)),
        _ => Err(CameraError::Setting {
            key: KEY,
            reason: format!("asked for {asked:?} it gives {taken:?}"),
        }),
    }
}

impl GenicamCamera {
    /// Opens the camera with the given id (name, serial number or address), or the first one found.
    pub fn open(settings: &config::Camera) -> Result<Self, CameraError> {
        let name = (!settings.device.is_empty()).then_some(settings.device.as_str());
        let camera = aravis::Camera::new(name).map_err(|e| {
            let wanted = if settings.device.is_empty() {
                "on any interface".into()
            } else {
                format!("{:?}", settings.device)
            };
            CameraError::NotFound(wanted, e.message().to_owned())
        })?;
        let text =
            |r: Result<aravis::glib::GString, _>| r.map(|s| s.to_string()).unwrap_or_default();
        let description = format!(
            "{} {} {}",
            text(camera.vendor_name()),
            text(camera.model_name()),
            text(camera.device_serial_number())
        );
        if camera.is_gv_device() {
            camera.gv_set_stream_options(GvStreamOption::PACKET_SOCKET_DISABLED);
        }
        camera
            .set_pixel_format_from_string(&settings.pixel_format)
            .map_err(setting("camera.pixel_format"))?;
        let size = set_region(&camera, settings.region)?;
        Ok(Self {
            camera,
            settings: settings.clone(),
            description,
            size,
            stream: None,
            armed: false,
            last_id: None,
            sequence: 0,
        })
    }

    fn stop(&mut self) -> Result<(), CameraError> {
        if std::mem::take(&mut self.armed) {
            self.camera.stop_acquisition().map_err(failed)?;
        }
        // What was under way when it stopped belongs to nobody.
        if let Some(stream) = &self.stream {
            while let Some(buffer) = stream.try_pop_buffer() {
                give(stream, buffer);
            }
        }
        Ok(())
    }

    fn create_stream(&self) -> Result<Stream, CameraError> {
        let stream = self.camera.create_stream().map_err(failed)?;
        if let Some(gv) = stream.downcast_ref::<aravis::GvStream>() {
            gv.set_socket_buffer(GvStreamSocketBuffer::Auto);
        }
        let payload = self.camera.payload().map_err(failed)? as usize;
        for _ in 0..BUFFERS {
            give(&stream, Buffer::new_allocate(payload));
        }
        Ok(stream)
    }

    /// Asks for frames by software until one comes whole. A camera that has no software trigger goes
    /// unprimed: its first frame may be lost, which the matching of frames to triggers finds.
    fn prime(&self, stream: &Stream, exposure: &Exposure) -> Result<(), CameraError> {
        let c = &self.camera;
        if c.set_trigger("Software").is_err() {
            return Ok(());
        }
        c.start_acquisition().map_err(failed)?;
        let patience = PRIME_TIMEOUT + Duration::from_secs_f64(exposure.ms.max(0.0) / 1000.0);
        for _ in 0..PRIME_TRIES {
            if c.software_trigger().is_err() {
                break;
            }
            if let Some(buffer) = stream.timeout_pop_buffer(patience.as_micros() as u64) {
                let whole = matches!(buffer.status(), BufferStatus::Success);
                give(stream, buffer);
                if whole {
                    break;
                }
            }
        }
        c.stop_acquisition().map_err(failed)
    }

    /// `None` if nothing says which frame it is: it is lost, as one of which nothing came.
    fn frame(&mut self, buffer: &Buffer) -> Result<Option<Frame>, CameraError> {
        let id = buffer.frame_id();
        if id == UNKNOWN {
            return Ok(None);
        }
        // 16-bit counters wrap round to 1; frames that were lost between count too.
        self.sequence += match self.last_id {
            None => 1,
            Some(last) if id > last => id - last,
            Some(last) => (id + 65_535).saturating_sub(last).max(1),
        };
        self.last_id = Some(id);
        let picture = match buffer.status() {
            BufferStatus::Success => Some(self.picture(buffer)?),
            _ => None,
        };
        Ok(Some(Frame {
            sequence: self.sequence,
            time_us: (buffer.timestamp() / 1000) as i64,
            picture,
        }))
    }

    fn picture(&self, buffer: &Buffer) -> Result<Picture, CameraError> {
        let (width, height) = (
            buffer.image_width().max(0) as usize,
            buffer.image_height().max(0) as usize,
        );
        let data = buffer.image_data();
        let format = buffer.image_pixel_format();
        let wrong = || {
            CameraError::Failed(format!(
                "{} bytes for {width} × {height} pixels",
                data.len()
            ))
        };
        // Bits of a pixel in its 16-bit word, low-aligned.
        let bits = match format {
            PixelFormat::MONO_8 => {
                let pixels = data.get(..width * height).ok_or_else(wrong)?.to_vec();
                return Image::from_vec(width, height, pixels)
                    .map(Picture::Eight)
                    .ok_or_else(wrong);
            }
            PixelFormat::MONO_10 => 10,
            PixelFormat::MONO_12 => 12,
            PixelFormat::MONO_14 => 14,
            PixelFormat::MONO_16 => 16,
            _ => {
                return Err(CameraError::Setting {
                    key: "camera.pixel_format",
                    reason: "only unpacked Mono formats are read".into(),
                });
            }
        };
        let pixels: Vec<u16> = data
            .chunks_exact(2)
            .take(width * height)
            .map(|b| u16::from_le_bytes([b[0], b[1]]) << (16 - bits))
            .collect();
        Image::from_vec(width, height, pixels)
            .map(Picture::Sixteen)
            .ok_or_else(wrong)
    }
}

impl Camera for GenicamCamera {
    fn description(&self) -> String {
        self.description.clone()
    }

    fn size(&self) -> (u32, u32) {
        self.size
    }

    fn arm(&mut self, exposure: &Exposure) -> Result<(), CameraError> {
        self.stop()?;
        let c = &self.camera;
        if c.is_exposure_auto_available().unwrap_or(false) {
            c.set_exposure_time_auto(Auto::Off)
                .map_err(setting("camera.exposure_laser_ms"))?;
        }
        c.set_exposure_time(exposure.ms * 1000.0)
            .map_err(setting("camera.exposure_laser_ms"))?;
        if c.is_gain_available().unwrap_or(false) {
            if c.is_gain_auto_available().unwrap_or(false) {
                c.set_gain_auto(Auto::Off)
                    .map_err(setting("camera.gain_db"))?;
            }
            c.set_gain(exposure.gain_db)
                .map_err(setting("camera.gain_db"))?;
        }
        c.set_acquisition_mode(AcquisitionMode::Continuous)
            .map_err(failed)?;
        if self.stream.is_none() {
            let stream = self.create_stream()?;
            self.prime(&stream, exposure)?;
            self.stream = Some(stream);
            self.stop()?;
        }
        let c = &self.camera;
        match self.settings.trigger {
            TriggerSource::Board => c
                .set_trigger(&self.settings.trigger_line)
                .map_err(setting("camera.trigger_line"))?,
            TriggerSource::Software => c
                .set_trigger("Software")
                .map_err(setting("camera.trigger"))?,
            TriggerSource::Free => c.clear_triggers().map_err(setting("camera.trigger"))?,
        }
        c.start_acquisition().map_err(failed)?;
        self.armed = true;
        self.last_id = None;
        Ok(())
    }

    fn wait(&mut self, timeout: Duration) -> Result<Option<Frame>, CameraError> {
        let stream = match &self.stream {
            Some(stream) if self.armed => stream.clone(),
            _ => return Err(CameraError::Failed("it is not armed".into())),
        };
        let until = Instant::now() + timeout;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            let buffer = match u64::try_from(left.as_micros()).unwrap_or(u64::MAX) {
                0 => stream.try_pop_buffer(),
                micros => stream.timeout_pop_buffer(micros),
            };
            let Some(buffer) = buffer else {
                return Ok(None);
            };
            let frame = self.frame(&buffer);
            give(&stream, buffer);
            if let Some(frame) = frame? {
                return Ok(Some(frame));
            }
        }
    }

    fn fire(&mut self) -> Result<(), CameraError> {
        if self.settings.trigger == TriggerSource::Software {
            self.camera.software_trigger().map_err(failed)?;
        }
        Ok(())
    }

    fn disarm(&mut self) -> Result<(), CameraError> {
        self.stop()
    }
}

impl Drop for GenicamCamera {
    fn drop(&mut self) {
        let _ = self.stop();
    }
}
