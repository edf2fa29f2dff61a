//! What stands in a session.json that this program does not know: other programs' keys, somebody's
//! notes. A recording that grows keeps them, with what they belong to.

use crate::session::Manifest;
use serde_json::Value;

/// A session.json as it was found, and what of it is known.
#[derive(Clone, Debug)]
pub struct Kept {
    found: Value,
    known: Value,
}

impl Kept {
    /// What is not known of `text`, of which `manifest` was read; `None` if all is.
    pub fn of(text: &[u8], manifest: &Manifest) -> Option<Self> {
        let found: Value = serde_json::from_slice(text).ok()?;
        let known = serde_json::to_value(manifest).ok()?;
        let mut all = known.clone();
        put(&mut all, &found, &known, true);
        (all != known).then_some(Self { found, known })
    }

    /// The manifest as it is now, with that.
    ///
    /// # Errors
    /// It can't be written as JSON.
    pub fn with(&self, now: &Manifest) -> serde_json::Result<Value> {
        let mut all = serde_json::to_value(now)?;
        put(&mut all, &self.found, &self.known, true);
        Ok(all)
    }
}

/// Puts into `now` what `found` has beside `known`. `same`: it is the same thing as it was.
fn put(now: &mut Value, found: &Value, known: &Value, same: bool) {
    match (now, found, known) {
        (Value::Object(now), Value::Object(found), Value::Object(known)) => {
            for (key, value) in found {
                match (known.get(key), now.get_mut(key)) {
                    (Some(known), Some(now)) => {
                        // When it was recorded changes with every image; it is the recording's all the same.
                        let same = key == "recorded" || is_same(now, known);
                        put(now, value, known, same);
                    }
                    // Known, and no longer there.
                    (Some(_), None) => {}
                    (None, None) if same => {
                        now.insert(key.clone(), value.clone());
                    }
                    (None, _) => {}
                }
            }
        }
        (Value::Array(now), Value::Array(found), Value::Array(known)) => {
            for now in now {
                let stood = std::iter::zip(found, known).find(|(_, known)| is_same(now, known));
                if let Some((found, known)) = stood {
                    put(now, found, known, true);
                }
            }
        }
        _ => {}
    }
}

/// A thing that names an image is the same if it names the same one, any other if nothing has changed.
fn is_same(now: &Value, then: &Value) -> bool {
    let image = |thing: &Value| {
        ["/image", "/off", "/on/0/image", "/frames/0/image"]
            .iter()
            .find_map(|at| thing.pointer(at).and_then(Value::as_str).map(str::to_owned))
    };
    match (image(now), image(then)) {
        (Some(now), Some(then)) => now == then,
        (None, None) => now == then,
        _ => false,
    }
}
