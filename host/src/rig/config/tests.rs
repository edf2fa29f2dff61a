//! Defaults, refusals with their keys, numbers for the board.

use super::*;

fn parse(text: &str) -> Result<Rig, ConfigError> {
    Rig::parse(text, Path::new("rig.toml"))
}

#[test]
fn the_example_says_every_default() {
    let rig = parse(EXAMPLE).unwrap();
    assert_eq!(rig, Rig::default());
    assert_eq!(rig, parse("").unwrap());
    // Every key that there is stands in the example.
    let all: toml::Table = toml::from_str(&toml::to_string(&rig).unwrap()).unwrap();
    let example: toml::Table = toml::from_str(EXAMPLE).unwrap();
    for (table, keys) in all {
        for key in keys.as_table().unwrap().keys() {
            assert!(example[&table].get(key).is_some(), "{table}.{key}");
        }
    }
}

#[test]
fn what_is_wrong_is_said_with_its_key() {
    for (text, words) in [
        (
            "[board]\nspeed = 3",
            "line 2, board.speed: unknown field `speed`",
        ),
        (
            "[camera]\nkind = \"usb\"",
            "line 2, camera.kind: unknown variant `usb`",
        ),
        (
            "[board]\nsteps_per_mm = [800, 1, 1]",
            "line 2, board.steps_per_mm: invalid length 3",
        ),
        (
            "[camera]\nregion = [0, 0, 640]",
            "line 2, camera.region: invalid length 3, expected 4 numbers",
        ),
        (
            "[scan]\n\nmode = \"warp\"",
            "line 3, scan.mode: unknown variant `warp`",
        ),
        (
            "[board]\ntravel_mm = \"long\"",
            "line 2, board.travel_mm: invalid type: string",
        ),
        (
            "scan = { count = -1 }",
            "line 1, scan.count: invalid value: integer",
        ),
        ("board = 3", "line 1, board: invalid type: integer"),
        ("[rail]\nx = 1", "line 1, rail: unknown field `rail`"),
        (
            "[camera]\nexposure_laser_ms = 0.0",
            "camera.exposure_laser_ms is 0: give 0.001 to 1000",
        ),
        ("[board]\nsteps_per_mm = [0, 1]", "board.steps_per_mm is 0"),
        (
            "[board]\nsteps_per_mm = [800, 1]\nmax_speed_mm_s = 900.0",
            "board.max_speed_mm_s is 900000",
        ),
        (
            "[scan]\ncount = 200",
            "scan.count is 200: give fewer positions: the last would lie at 398 mm",
        ),
        ("[checkerboard]\ncolumns = 5", "checkerboard.rows is 6"),
        (
            "[simulation]\nprofile = \"easy\"",
            "simulation.profile is \"easy\"",
        ),
        ("[camera]\nkind = \"v4l\"", "camera.device is \"\""),
        ("[camera]\nkind = \"folder\"", "unknown variant `folder`"),
        ("[scan]\nmode = \"ramped\"", "unknown variant `ramped`"),
        (
            "[camera]\nexposure_laser_ms = 20.0",
            "scan.speed_mm_s is 20: give at most 10.000",
        ),
        (
            "[camera]\nkind = \"v4l\"\ndevice = \"/dev/video0\"",
            "camera.trigger is board: give \"free\"",
        ),
        (
            "[camera]\nkind = \"v4l\"\ndevice = \"/dev/video0\"\ntrigger = \"software\"",
            "camera.trigger is software: give \"free\"",
        ),
        (
            "[camera]\nkind = \"v4l\"\ndevice = \"x\"\ntrigger = \"free\"\ngain_db = 6.0",
            "camera.gain_db is 6: give 0",
        ),
        (
            "[camera]\nkind = \"v4l\"\ndevice = \"x\"\ntrigger = \"free\"\nregion = [8, 0, 640, 480]",
            "camera.region is [8, 0, 640, 480]: give [0, 0, width, height]",
        ),
        (
            "[camera]\nkind = \"v4l\"\ndevice = \"x\"\ntrigger = \"free\"\npixel_format = \"Mono12\"",
            "camera.pixel_format is \"Mono12\": give \"Mono8\"",
        ),
        (
            "[camera]\nregion = [0, 0, 640, 0]",
            "camera.region is [0, 0, 640, 0]: give [left, top, width, height]",
        ),
        ("[scan]\nspeed_mm_s = nan", "scan.speed_mm_s is NaN"),
        // What the board itself would refuse at the scan.
        (
            "[camera]\nexposure_laser_ms = 1.0\nframe_time_ms = 5.0\n[scan]\nspeed_mm_s = 40.0\nspacing_mm = 0.5",
            "scan.speed_mm_s is 40: give less, or a greater scan.start_mm",
        ),
        (
            "[scan]\nspeed_mm_s = 0.5\nspacing_mm = 0.01",
            "scan.spacing_mm is 0.01: give more, or a lower scan.speed_mm_s: trigger 1 would come",
        ),
        (
            "[scan]\nspeed_mm_s = 2.0\nspacing_mm = 0.0015",
            "scan.spacing_mm is 0.0015: give more",
        ),
        (
            "[scan]\nstart_mm = 240.0",
            "scan.count is 31: give fewer positions: with its ramp down the slide would go to 301.00",
        ),
        (
            "[light]\nspacing_mm = 0.001",
            "light.spacing_mm is 0.001: give at least 0.002",
        ),
        // 2 mm at 20 mm/s are 100 ms.
        (
            "[camera]\nframe_time_ms = 95.1\nexposure_laser_ms = 5.0",
            "scan.speed_mm_s is 20: give at most 19.980, or a shorter camera.exposure_laser_ms",
        ),
        // No frame would ever come in time.
        (
            "[camera]\ntrigger = \"software\"\nexposure_laser_ms = 1000.0",
            "camera.timeout_ms is 500: give at least 1020: no frame comes sooner than camera.exposure_laser_ms",
        ),
        (
            "[camera]\nexposure_board_ms = 480.5",
            "camera.timeout_ms is 500: give at least 500.5: no frame comes sooner than camera.exposure_board_ms",
        ),
        ("[board\n", "line 1"),
    ] {
        let said = parse(text).unwrap_err().to_string();
        assert!(
            said.starts_with("rig.toml: ") && said.contains(words),
            "{text}: {said}"
        );
        assert!(!said.contains('\n'));
    }
}

#[test]
fn what_just_fits_is_sound() {
    for text in [
        "[camera]\nframe_time_ms = 95.0\nexposure_laser_ms = 5.0",
        // Where it stops there is time for all of it.
        "[camera]\nframe_time_ms = 500.0\nexposure_laser_ms = 50.0\ntimeout_ms = 550.0\n[scan]\nmode = \"stop\"",
        "[camera]\nexposure_board_ms = 480.0",
        // A camera that the board does not trigger is waited for at each position.
        "[camera]\ntrigger = \"software\"\nexposure_laser_ms = 15.0",
        "[camera]\ntrigger = \"free\"\nexposure_laser_ms = 20.0\nframe_time_ms = 200.0",
        "[camera]\nkind = \"v4l\"\ndevice = \"x\"\ntrigger = \"free\"\nexposure_laser_ms = 20.0",
        "[scan]\nstart_mm = 10.0\nspeed_mm_s = 40.0",
        "[scan]\nstart_mm = 238.9",
    ] {
        parse(text).unwrap();
    }
}

#[test]
fn numbers_go_to_the_board_without_rounding() {
    let rig = parse("[board]\nsteps_per_mm = [2032, 5]\n[scan]\nspacing_mm = 1.5").unwrap();
    let config = rig.board_config(rig.camera.exposure_laser_ms);
    assert_eq!(
        config.steps_per_mm,
        StepsPerMm {
            numerator: 2032,
            denominator: 5
        }
    );
    assert_eq!(config.exposure_us, 5000);
    assert_eq!(rig.scan_request().spacing_um, 1500);
    assert!((rig.mm(2032) - 5.0).abs() < 1e-12);
    config.validate().unwrap();
}
