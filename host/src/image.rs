//! Grey images in memory. Pixel (u, v) has its centre at integer coordinates.

/// What a pixel can be: 8 or 16 bits of grey.
pub trait Pixel:
    Copy + Default + Ord + Send + Sync + std::fmt::Debug + Into<f32> + 'static
{
    /// The value at which the sensor saturates.
    const MAX: f32;
    /// Bits a pixel.
    const BITS: u32;
    /// The value as it stands, in 16 bits.
    fn to_u16(self) -> u16;
    /// Rounded and clamped from a float (in the pixel's own units).
    fn from_f32(value: f32) -> Self;
    /// From 8-bit samples, scaled to the full range.
    fn from_bytes(samples: Vec<u8>) -> Vec<Self>;
    /// From 16-bit samples, scaled to the full range.
    fn from_words(samples: Vec<u16>) -> Vec<Self>;
    /// The samples as a file holds them, high byte first.
    fn to_be_bytes(pixels: &[Self]) -> std::borrow::Cow<'_, [u8]>;
}

impl Pixel for u8 {
    const MAX: f32 = 255.0;
    const BITS: u32 = 8;
    #[inline]
    fn to_u16(self) -> u16 {
        u16::from(self)
    }
    #[inline]
    fn from_f32(value: f32) -> Self {
        value.round() as u8 // saturates
    }
    fn from_bytes(samples: Vec<u8>) -> Vec<Self> {
        samples
    }
    fn from_words(samples: Vec<u16>) -> Vec<Self> {
        samples.iter().map(|s| (s / 257) as u8).collect()
    }
    fn to_be_bytes(pixels: &[Self]) -> std::borrow::Cow<'_, [u8]> {
        pixels.into()
    }
}

impl Pixel for u16 {
    const MAX: f32 = 65535.0;
    const BITS: u32 = 16;
    #[inline]
    fn to_u16(self) -> u16 {
        self
    }
    #[inline]
    fn from_f32(value: f32) -> Self {
        value.round() as u16 // saturates
    }
    fn from_bytes(samples: Vec<u8>) -> Vec<Self> {
        samples.iter().map(|s| u16::from(*s) * 257).collect()
    }
    fn from_words(samples: Vec<u16>) -> Vec<Self> {
        samples
    }
    fn to_be_bytes(pixels: &[Self]) -> std::borrow::Cow<'_, [u8]> {
        pixels.iter().flat_map(|p| p.to_be_bytes()).collect()
    }
}

/// A grey image, row by row without padding.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image<P> {
    width: usize,
    height: usize,
    pixels: Vec<P>,
}

impl<P: Pixel> Image<P> {
    /// An image of one value.
    pub fn new(width: usize, height: usize, value: P) -> Self {
        Self {
            width,
            height,
            pixels: vec![value; width * height],
        }
    }

    /// From rows of pixels; `None` if their number is not width × height.
    pub fn from_vec(width: usize, height: usize, pixels: Vec<P>) -> Option<Self> {
        (pixels.len() == width * height).then_some(Self {
            width,
            height,
            pixels,
        })
    }

    /// Pixels in a row.
    #[inline]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    #[inline]
    pub fn height(&self) -> usize {
        self.height
    }

    /// All pixels, row by row.
    #[inline]
    pub fn pixels(&self) -> &[P] {
        &self.pixels
    }

    /// All pixels, row by row, to write.
    #[inline]
    pub fn pixels_mut(&mut self) -> &mut [P] {
        &mut self.pixels
    }

    /// Row v.
    #[inline]
    pub fn row(&self, v: usize) -> &[P] {
        &self.pixels[v * self.width..(v + 1) * self.width]
    }

    /// The pixel in column u of row v.
    #[inline]
    pub fn at(&self, u: usize, v: usize) -> P {
        self.row(v)[u]
    }

    /// Its pixels, row by row.
    pub fn into_vec(self) -> Vec<P> {
        self.pixels
    }
}
