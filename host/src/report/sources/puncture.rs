//! The puncture's section, from the solver's report or from the files that it wrote.

use crate::report::model::{Model, Puncture, PunctureRun};
use anyhow::{Context, ensure};
use serde_json::Value;
use std::path::Path;

/// Reads puncture.json and its curves from a folder.
///
/// # Errors
/// A file that is missing or not of its format.
pub fn puncture_folder(folder: &Path) -> anyhow::Result<Puncture> {
    let path = folder.join("puncture.json");
    let text = std::fs::read_to_string(&path).with_context(|| {
        format!(
            "{}: give a folder that `cannula puncture` wrote",
            path.display()
        )
    })?;
    let json: Value = serde_json::from_str(&text).with_context(|| path.display().to_string())?;
    ensure!(
        json["format"] == "cannula-puncture/1",
        "{}: its format is not cannula-puncture/1",
        path.display()
    );
    let runs = json["runs"].as_array().map_or(&[][..], Vec::as_slice);
    ensure!(
        !runs.is_empty(),
        "{}: it holds no run: make it again with `cannula puncture`",
        path.display()
    );
    let angle = |at: &Value| {
        let told = at["angle_deg"].as_f64();
        told.with_context(|| format!("{}: an angle_deg is missing in it", path.display()))
    };
    let runs = runs
        .iter()
        .map(|run| {
            let name = run["curve"].as_str().unwrap_or_default();
            // A curve lies beside its puncture.json, nowhere else.
            ensure!(
                !name.is_empty() && Path::new(name).file_name() == Some(name.as_ref()),
                "{}: a run names no curve in its folder",
                path.display()
            );
            Ok(PunctureRun {
                model: Model::Reference,
                angle_deg: angle(run)?,
                curve: curve(&folder.join(name))?,
                events: events(&run["events"]),
            })
        })
        .collect::<anyhow::Result<Vec<_>>>()?;
    let decision = &json["decision"];
    Ok(Puncture {
        runs,
        angle_deg: angle(decision)?,
        criterion: decision["criterion"]
            .as_str()
            .unwrap_or_default()
            .to_owned(),
        ..Puncture::default()
    })
}

fn events(json: &Value) -> Vec<(String, f64, Option<f64>, f64)> {
    json.as_array()
        .map_or(&[][..], Vec::as_slice)
        .iter()
        .filter_map(|e| {
            Some((
                e["layer"].as_str()?.to_owned(),
                e["contact_s"].as_f64()?,
                e["puncture_s"].as_f64(),
                e["peak_force_n"].as_f64().unwrap_or(f64::NAN),
            ))
        })
        .collect()
}

/// time_s, depth_mm, force_n, skin_n, fat_n, vein_n: all but the depth.
fn curve(path: &Path) -> anyhow::Result<Vec<[f64; 5]>> {
    let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
    let rows = text
        .lines()
        .skip(1)
        .map(|line| {
            let cells: Vec<f64> = line
                .split(',')
                .filter_map(|c| c.trim().parse().ok())
                .collect();
            match cells.as_slice() {
                [t, _, whole, skin, fat, vein] => Ok([*t, *whole, *skin, *fat, *vein]),
                _ => anyhow::bail!("{}: a row has not six numbers: {line}", path.display()),
            }
        })
        .collect::<anyhow::Result<Vec<_>>>()?;
    ensure!(!rows.is_empty(), "{}: it has no rows", path.display());
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_read_and_a_broken_one_named() {
        let folder = tempfile::tempdir().unwrap();
        let json = r#"{"format": "cannula-puncture/1", "runs": [{"angle_deg": 30, "curve": "curve_30.csv",
            "events": [{"layer": "skin", "contact_s": 0.0, "puncture_s": 0.4, "peak_force_n": 1.5}]}],
            "decision": {"angle_deg": 60, "criterion": "paper"}}"#;
        std::fs::write(folder.path().join("puncture.json"), json).unwrap();
        let error = puncture_folder(folder.path()).unwrap_err();
        assert!(format!("{error:#}").contains("curve_30.csv"));
        let csv =
            "time_s,depth_mm,force_n,skin_n,fat_n,vein_n\n0,0,0,0,0,0\n0.1,0.5,1.5,1,0.25,0.25\n";
        std::fs::write(folder.path().join("curve_30.csv"), csv).unwrap();
        let p = puncture_folder(folder.path()).unwrap();
        assert_eq!(p.runs[0].curve, [[0.0; 5], [0.1, 1.5, 1.0, 0.25, 0.25]]);
        assert_eq!(p.runs[0].events, [("skin".to_owned(), 0.0, Some(0.4), 1.5)]);
        assert_eq!((p.angle_deg, p.criterion.as_str()), (60.0, "paper"));
        let spoiled = |json: String| {
            std::fs::write(folder.path().join("puncture.json"), json).unwrap();
            format!("{:#}", puncture_folder(folder.path()).unwrap_err())
        };
        let away = spoiled(json.replace("curve_30.csv", "../curve_30.csv"));
        assert!(away.contains("names no curve in its folder"), "{away}");
        let unsaid = spoiled(json.replace("\"angle_deg\": 30, ", ""));
        assert!(unsaid.contains("angle_deg is missing"), "{unsaid}");
        let decision =
            r#"{"format": "cannula-puncture/1", "runs": [], "decision": {"angle_deg": 60}}"#;
        let none = spoiled(decision.into());
        assert!(none.contains("holds no run"), "{none}");
        std::fs::write(folder.path().join("curve_30.csv"), "time_s,depth_mm\n").unwrap();
        let empty = spoiled(json.into());
        assert!(empty.contains("curve_30.csv: it has no rows"), "{empty}");
    }
}
