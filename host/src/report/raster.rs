//! Images inside the page: PNG as a data URI, with lines drawn over it as SVG.

use super::model::Gray;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;

/// The image as a `data:` URI; empty for an image without pixels.
pub fn data_uri(image: &Gray) -> String {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, image.width as u32, image.height as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    // Smaller by a tenth would cost as much as the calibration.
    encoder.set_compression(png::Compression::Fast);
    let written = encoder
        .write_header()
        .and_then(|mut w| w.write_image_data(&image.pixels));
    match written {
        Ok(()) => format!("data:image/png;base64,{}", STANDARD.encode(bytes)),
        Err(_) => String::new(),
    }
}

/// Bytes in base64.
pub fn base64(bytes: &[u8]) -> String {
    STANDARD.encode(bytes)
}

/// Every pixel as a square of so many: scaling by the browser would smooth it, and its pixelated
/// scaling does not survive printing.
pub fn enlarged(image: &Gray, times: usize) -> Gray {
    let wide = |row: &[u8]| -> Vec<u8> {
        row.iter()
            .flat_map(|&p| std::iter::repeat_n(p, times))
            .collect()
    };
    Gray {
        width: image.width * times,
        height: image.height * times,
        pixels: image
            .pixels
            .chunks(image.width.max(1))
            .flat_map(|row| wide(row).repeat(times))
            .collect(),
    }
}

/// Brightens an image so that its 99.5th percentile becomes white: recordings are dark.
pub fn brightened(image: &Gray) -> Gray {
    let mut counts = [0usize; 256];
    for &p in &image.pixels {
        counts[p as usize] += 1;
    }
    let mut left = image.pixels.len() / 200;
    let mut white = 255usize;
    while white > 1 && counts[white] <= left {
        left -= counts[white];
        white -= 1;
    }
    Gray {
        pixels: image
            .pixels
            .iter()
            .map(|&p| (usize::from(p) * 255 / white).min(255) as u8)
            .collect(),
        ..*image
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_goes_through_its_uri() {
        let image = Gray {
            width: 3,
            height: 2,
            pixels: vec![0, 1, 2, 3, 4, 255],
        };
        let uri = data_uri(&image);
        let bytes = STANDARD
            .decode(uri.strip_prefix("data:image/png;base64,").unwrap())
            .unwrap();
        let back = ::image::load_from_memory(&bytes).unwrap().to_luma8();
        assert_eq!(back.into_raw(), image.pixels);
    }

    #[test]
    fn pixels_become_squares() {
        let image = Gray {
            width: 2,
            height: 1,
            pixels: vec![7, 9],
        };
        let large = enlarged(&image, 2);
        assert_eq!((large.width, large.height), (4, 2));
        assert_eq!(large.pixels, [7, 7, 9, 9, 7, 7, 9, 9]);
    }

    #[test]
    fn dark_images_become_bright_and_empty_ones_survive() {
        let dark = Gray {
            width: 100,
            height: 10,
            pixels: (0..1000).map(|i| (i % 50) as u8).collect(),
        };
        assert_eq!(brightened(&dark).pixels.iter().max(), Some(&255));
        assert!(brightened(&Gray::default()).pixels.is_empty());
        assert!(data_uri(&Gray::default()).is_empty());
    }
}
