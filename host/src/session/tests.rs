use super::*;
use std::path::Path;

const NOMINAL: &str = r#"{
  "format": "cannula-session/1", "extra": {"ignored": [1, 2]},
  "image": {"width": 1280, "height": 960, "also": 1},
  "board": {"columns": 8, "rows": 6, "square_mm": 10.0},
  "camera": [{"image": "camera/00.png"}],
  "light": [{"off": "off.png", "on": [
     {"slide_mm": 0.0, "slide_steps": 0, "image": "a.png"},
     {"slide_mm": 5.0, "slide_steps": 1600, "image": "b.png"},
     {"slide_mm": 10.0, "slide_steps": 3200, "image": "c.png"}]}],
  "scan": {"ambient": "amb.png", "frames": [
     {"slide_mm": 0.0, "image": "0.png", "trigger_us": 7},
     {"slide_mm": 2.0, "image": "1.png"}, {"slide_mm": 4.0, "image": "2.png"}]},
  "entry": {"pixel": [640.0, 480.0], "vein": [[620.0, 520.0], [660.0, 440.0]], "radius_mm": 12.0}
}"#;

fn text(with: &[(&str, &str)]) -> String {
    with.iter().fold(NOMINAL.to_owned(), |t, (from, to)| {
        assert!(t.contains(from), "{from}");
        t.replacen(from, to, 1)
    })
}

fn refusal(with: &[(&str, &str)]) -> String {
    parse(text(with).as_bytes(), Path::new("s/session.json"))
        .expect_err("must be refused")
        .to_string()
}

#[test]
fn a_session_is_read_and_unknown_keys_are_ignored() {
    let m = parse(NOMINAL.as_bytes(), Path::new("x")).unwrap();
    assert_eq!(m.light[0].on[1].slide_steps, Some(1600));
    assert_eq!(m.scan.as_ref().unwrap().frames[0].trigger_us, Some(7));
    assert_eq!(m.images().count(), 1 + 4 + 4);
    // What is written reads back the same.
    let again = serde_json::to_vec(&m).unwrap();
    assert_eq!(parse(&again, Path::new("x")).unwrap(), m);
}

#[test]
fn each_fault_is_named() {
    for (with, word) in [
        (vec![("session/1", "session/9")], "\"format\""),
        (vec![("\"width\": 1280", "\"width\": 0")], "\"image\" is 0"),
        (vec![("\"columns\": 8", "\"columns\": 5")], "exchange"),
        (vec![("\"rows\": 6", "\"rows\": 1")], "inner corners"),
        (
            vec![("\"square_mm\": 10.0", "\"square_mm\": 0.01")],
            "square_mm",
        ),
        (vec![("5.0, \"slide_steps\": 1600", "0.0")], "twice"),
        (
            vec![("5.0, \"slide_steps\": 1600", "11.0")],
            "order of travel",
        ),
        (
            vec![("5.0, \"slide_steps\": 1600", "6.0, \"slide_steps\": 1600")],
            "slide_steps",
        ),
        (
            vec![("\"slide_mm\": 4.0", "\"slide_mm\": 4000.0")],
            "micrometres",
        ),
        (
            vec![("\"slide_mm\": 4.0", "\"slide_mm\": 40.0")],
            "the scan runs from 0 to 40 mm",
        ),
        (
            vec![
                ("\"slide_mm\": 2.0", "\"slide_mm\": 0.002"),
                ("\"slide_mm\": 4.0", "\"slide_mm\": 0.004"),
            ],
            "metres",
        ),
        (vec![("\"b.png\"", "\"a.png\"")], "twice"),
        (
            vec![("\"off\": \"off.png\"", "\"off\": \"a.png\"")],
            "both as \"off\"",
        ),
        (vec![("[640.0, 480.0]", "[1640.0, 480.0]")], "entry.pixel"),
        (
            vec![("[[620.0, 520.0], [660.0, 440.0]]", "[[620.0, 520.0]]")],
            "vein",
        ),
        (
            vec![("\"radius_mm\": 12.0", "\"radius_mm\": 0")],
            "radius_mm",
        ),
        (
            vec![(
                "\"entry\"",
                "\"robot_from_camera\": [[1,0,0,0],[0,1,0,0],[0,0,2,0],[0,0,0,1]], \"entry\"",
            )],
            "robot_from_camera",
        ),
        (
            vec![("\"on\": [", "\"on\": [], \"was\": [")],
            "light[0].on is empty",
        ),
        (vec![("1280", "\"wide\"")], "not a session file"),
    ] {
        let said = refusal(&with);
        assert!(
            said.contains(word) && said.starts_with("s/session.json: "),
            "{with:?}: {said}"
        );
        assert!(!said.contains('\n'), "one sentence: {said}");
    }
}

#[test]
fn a_scan_may_run_backwards() {
    let m = text(&[
        (
            "\"slide_mm\": 0.0, \"image\": \"0",
            "\"slide_mm\": 6.0, \"image\": \"0",
        ),
        ("\"slide_mm\": 2.0", "\"slide_mm\": 5.0"),
        ("\"slide_mm\": 4.0", "\"slide_mm\": 3.0"),
    ]);
    assert!(parse(m.as_bytes(), Path::new("x")).is_ok());
}

/// PNGs of every kind written by `image`, an encoder of its own.
#[test]
fn images_of_every_kind_come_out_alike() {
    let dir = tempfile::tempdir().unwrap();
    let (w, h) = (33u32, 17u32);
    let value = |u: u32, v: u32| ((u * 7 + v * 5) % 256) as u8;
    let grey = image::GrayImage::from_fn(w, h, |u, v| image::Luma([value(u, v)]));
    let names = ["g8.png", "g16.png", "rgb8.png", "rgba8.png", "rgb16.png"];
    grey.save(dir.path().join(names[0])).unwrap();
    let d = image::DynamicImage::ImageLuma8(grey);
    d.to_luma16().save(dir.path().join(names[1])).unwrap();
    d.to_rgb8().save(dir.path().join(names[2])).unwrap();
    d.to_rgba8().save(dir.path().join(names[3])).unwrap();
    d.to_rgb16().save(dir.path().join(names[4])).unwrap();
    for (i, name) in names.iter().enumerate() {
        let path = dir.path().join(name);
        let head = header(&path).unwrap();
        assert_eq!((head.width, head.height), (w, h));
        assert_eq!(head.depth == Depth::Sixteen, i == 1 || i == 4);
        let eight: Image<u8> = decode(&path).unwrap().luma().unwrap();
        let sixteen: Image<u16> = decode(&path).unwrap().luma().unwrap();
        for v in 0..h {
            for u in 0..w {
                let want = value(u, v);
                assert_eq!(eight.at(u as usize, v as usize), want, "{name}");
                let got = i32::from(sixteen.at(u as usize, v as usize));
                assert!((got - i32::from(want) * 257).abs() <= 1, "{name} {got}");
            }
        }
    }
}

#[test]
fn the_laser_is_sought_in_its_own_channel() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("c.png");
    // White paper with a green pixel of nearly the same brightness.
    let mut rgb = image::RgbImage::from_pixel(16, 16, image::Rgb([200, 200, 200]));
    rgb.put_pixel(5, 6, image::Rgb([100, 250, 104]));
    rgb.save(&path).unwrap();
    let excess: Image<u8> = decode(&path).unwrap().laser(Some(Colour::Green)).unwrap();
    assert_eq!(excess.at(5, 6), 148);
    assert_eq!(excess.pixels().iter().filter(|p| **p > 0).count(), 1);
    let luma: Image<u8> = decode(&path).unwrap().luma().unwrap();
    assert_eq!(luma.at(5, 6), 189); // 29.9 + 146.75 + 11.856 = 188.5
}

#[test]
fn a_written_session_opens_and_broken_images_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let mut m = Manifest::new(64, 48);
    m.camera = vec![CameraView {
        image: "camera/00.png".into(),
    }];
    let image =
        Image::from_vec(64, 48, (0..64 * 48).map(|i| (i % 65_000) as u16).collect()).unwrap();
    write_png(&dir.path().join("camera/00.png"), &image).unwrap();
    write(dir.path(), &m).unwrap();
    let s = Session::open(dir.path()).unwrap();
    assert_eq!(s.depth, Depth::Sixteen);
    assert_eq!(s.luma::<u16>("camera/00.png").unwrap(), image);

    let path = dir.path().join("camera/00.png");
    let whole = std::fs::read(&path).unwrap();
    for cut in [0, 4, 20, 30, 60, whole.len() / 2, whole.len() - 20] {
        std::fs::write(&path, &whole[..cut]).unwrap();
        let e = match Session::open(dir.path()) {
            Err(e) => e,
            Ok(s) => s.luma::<u16>("camera/00.png").expect_err("cut short"),
        };
        let said = e.to_string();
        assert!(
            said.contains("00.png") && matches!(e, SessionError::BrokenImage { .. }),
            "{cut}: {said}"
        );
    }
    std::fs::remove_file(&path).unwrap();
    assert!(matches!(
        Session::open(dir.path()),
        Err(SessionError::MissingImage { .. })
    ));
    m.image.width = 65;
    write(dir.path(), &m).unwrap();
    write_png(&path, &image).unwrap();
    let said = Session::open(dir.path()).unwrap_err().to_string();
    assert!(
        said.contains("64 × 48") && said.contains("65 × 48"),
        "{said}"
    );
    let said = Session::open(&dir.path().join("nowhere"))
        .unwrap_err()
        .to_string();
    assert!(said.contains("not found"), "{said}");
}
