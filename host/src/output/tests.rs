use super::*;
use serde_json::{Value, json};

/// The contract's own example with numbers in it, and nothing beside.
pub(super) fn contract() -> Value {
    json!({ "format": "cannula-calibration/1",
      "camera": { "width": 1280, "height": 960, "fx": 2197.8, "fy": 2204.8, "u0": 626.6, "v0": 487.3,
                  "distortion": { "k1": -0.14, "k2": -0.04, "p1": 0, "p2": 0, "k3": -0.3 }, "rms_px": 0.01 },
      "light":  { "normal": [0.0, -0.8, 0.6], "a": -1.0, "b": -190.0,
                  "planes": [ { "slide_mm": 0, "normal": [0, -0.8, 0.6], "d": -190.0, "points": 9, "rms_mm": 0.01 } ],
                  "spacing_error_mm": 0, "offset_error_mm": 0 } })
}

pub(super) fn read(value: &Value) -> Result<CalibrationFile, OutputError> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("calibration.json");
    write_json(&path, value).unwrap();
    read_calibration(&path)
}

#[test]
fn a_bare_calibration_of_the_contract_is_read() {
    let file = read(&contract()).unwrap();
    let rig = file.rig().unwrap();
    assert_eq!(
        (rig.light.a, rig.light.b, rig.camera.fy),
        (-1.0, -190.0, 2204.8)
    );
    assert!(rig.covariance.iter().all(|v| *v == 0.0));
    assert_eq!(file.positions(), [0.0]);
    // One position: a and b are null.
    let mut one = contract();
    one["light"]["a"] = Value::Null;
    one["light"]["b"] = Value::Null;
    let rig = read(&one).unwrap().rig().unwrap();
    assert_eq!((rig.light.a, rig.light.b), (0.0, -190.0));
    let mut camera = contract();
    camera.as_object_mut().unwrap().remove("light");
    assert!(read(&camera).unwrap().rig().is_none());
}

#[test]
fn impossible_calibrations_are_refused() {
    for (pointer, value, word) in [
        ("/format", json!("cannula-calibration/9"), "format"),
        ("/camera/fx", json!(-3.0), "focal"),
        ("/light/normal", json!([0.0, -0.8, -0.6]), "normal"),
        ("/light/normal", json!([0.0, -1.8, 0.6]), "normal"),
        ("/light/a", Value::Null, "planes"),
        ("/camera/distortion", json!({}), "not a calibration"),
    ] {
        let mut bad = contract();
        *bad.pointer_mut(pointer).unwrap() = value;
        let said = read(&bad).unwrap_err().to_string();
        assert!(
            said.contains(word) && said.contains("calibration.json"),
            "{said}"
        );
    }
    let mut bad = contract();
    bad["covariance"] = json!([[1.0, 2.0], [3.0]]);
    assert!(read(&bad).unwrap_err().to_string().contains("covariance"));
}

#[test]
fn a_file_stands_whole_or_not_at_all() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("new/folder/x.json");
    write_whole(&path, |out| out.write_all(b"old")).unwrap();
    let failed = write_whole(&path, |out| {
        out.write_all(b"new")?;
        Err(std::io::Error::other("power cut"))
    });
    assert!(failed.unwrap_err().to_string().contains("power cut"));
    assert_eq!(std::fs::read(&path).unwrap(), b"old");
    let left = std::fs::read_dir(path.parent().unwrap()).unwrap().count();
    assert_eq!(left, 1, "no temporary file is left");
    let said = write_whole(dir.path(), |_| Ok(())).unwrap_err().to_string();
    assert!(said.contains("folder"), "{said}");
}

#[test]
fn numbers_stand_in_one_line_and_nothing_else_changes() {
    let value = json!({ "m": [[1.5, -2e-9], [3, 4]], "text": "[1,\n 2] \"[3", "mixed": [1, null], "none": [] });
    let text = super::numbers_in_one_line(&serde_json::to_string_pretty(&value).unwrap());
    assert_eq!(serde_json::from_str::<Value>(&text).unwrap(), value);
    assert!(
        text.contains("[1.5, -2e-9]") && text.contains("[3, 4]"),
        "{text}"
    );
}
