//! Writes pictures losslessly in the background, through a bounded queue.
//!
//! Memory stays bounded: at most [`Writer::new`]'s `queue` pictures wait. Where encoding or disk
//! can't keep up, [`Writer::push`] waits and the time is counted; a camera whose buffers overflow
//! meanwhile loses frames, which the matching names. An error (a full disk) is told at the next
//! push; the file in the making is removed, so that every file that stands is whole.

use super::camera::Picture;
use crate::session;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// A picture could not be written.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{path}: could not be written ({reason}); the recording stops here, what stands is whole", path = path.display())]
pub struct WriteError {
    /// The file.
    pub path: PathBuf,
    /// Why.
    pub reason: String,
}

/// How writing went.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Written {
    /// Files written.
    pub files: u64,
    /// Time that the camera's side had to wait for a place in the queue.
    pub waited: Duration,
}

type Job = (PathBuf, Picture);

#[derive(Default)]
struct Shared {
    failure: Mutex<Option<WriteError>>,
    files: AtomicU64,
}

/// The background writer.
pub struct Writer {
    queue: Option<SyncSender<Job>>,
    threads: Vec<JoinHandle<()>>,
    shared: Arc<Shared>,
    waited: Duration,
}

impl Writer {
    /// With `threads` encoders and room for `queue` pictures.
    pub fn new(threads: usize, queue: usize) -> std::io::Result<Self> {
        let (send, receive) = sync_channel::<Job>(queue.max(1));
        let receive = Arc::new(Mutex::new(receive));
        let shared = Arc::new(Shared::default());
        let threads = (0..threads.max(1))
            .map(|i| {
                let (receive, shared) = (receive.clone(), shared.clone());
                std::thread::Builder::new()
                    .name(format!("writer {i}"))
                    .spawn(move || work(&receive, &shared))
            })
            .collect::<std::io::Result<_>>()?;
        Ok(Self {
            queue: Some(send),
            threads,
            shared,
            waited: Duration::ZERO,
        })
    }

    /// Hands over a picture; waits while the queue is full. An error that writing has met since
    /// the last call is returned instead, and the picture is not taken.
    pub fn push(&mut self, path: PathBuf, picture: Picture) -> Result<(), WriteError> {
        self.check()?;
        let Some(queue) = &self.queue else {
            return Ok(());
        };
        match queue.try_send((path, picture)) {
            Ok(()) => {}
            Err(TrySendError::Full(job)) => {
                let began = Instant::now();
                // The encoders go on taking jobs after a failure, so this ends.
                let _ = queue.send(job);
                self.waited += began.elapsed();
            }
            Err(TrySendError::Disconnected(_)) => {}
        }
        self.check()
    }

    fn check(&self) -> Result<(), WriteError> {
        match &*self
            .shared
            .failure
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
        {
            Some(failure) => Err(failure.clone()),
            None => Ok(()),
        }
    }

    /// Waits until everything stands on disk.
    pub fn finish(mut self) -> Result<Written, WriteError> {
        self.join();
        self.check()?;
        Ok(Written {
            files: self.shared.files.load(Ordering::Relaxed),
            waited: self.waited,
        })
    }

    fn join(&mut self) {
        self.queue = None;
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        self.join();
    }
}

fn work(jobs: &Mutex<Receiver<Job>>, shared: &Shared) {
    loop {
        let job = jobs.lock().unwrap_or_else(PoisonError::into_inner).recv();
        let Ok((path, picture)) = job else { return };
        let failed = || {
            shared
                .failure
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .is_some()
        };
        if failed() {
            continue;
        }
        match write_whole(&path, &picture) {
            Ok(()) => {
                shared.files.fetch_add(1, Ordering::Relaxed);
            }
            Err(reason) => {
                let mut failure = shared
                    .failure
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner);
                failure.get_or_insert(WriteError { path, reason });
            }
        }
    }
}

/// Writes a picture as PNG under a passing name and renames it: it appears whole or not at all.
pub fn write_whole(path: &Path, picture: &Picture) -> Result<(), String> {
    let part = path.with_extension("part");
    let done = match picture {
        Picture::Eight(image) => session::write_png(&part, image),
        Picture::Sixteen(image) => session::write_png(&part, image),
    }
    .map_err(|e| cause(&e))
    .and_then(|()| std::fs::rename(&part, path).map_err(|e| e.to_string()));
    if done.is_err() {
        let _ = std::fs::remove_file(&part);
    }
    done
}

/// The innermost cause of an error: "No space left on device" rather than the path again.
fn cause(error: &dyn std::error::Error) -> String {
    let mut last = error;
    while let Some(next) = last.source() {
        last = next;
    }
    last.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Image;

    fn picture(seed: u8) -> Picture {
        let pixels = (0..64 * 48u32)
            .map(|i| (i as u8).wrapping_mul(31) ^ seed)
            .collect();
        Picture::Eight(Image::from_vec(64, 48, pixels).unwrap())
    }

    #[test]
    fn pictures_come_back_as_they_were() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = Writer::new(2, 4).unwrap();
        for i in 0..40u8 {
            writer
                .push(dir.path().join(format!("scan/{i:03}.png")), picture(i))
                .unwrap();
        }
        assert_eq!(writer.finish().unwrap().files, 40);
        for i in 0..40u8 {
            let path = dir.path().join(format!("scan/{i:03}.png"));
            let read: Image<u8> = session::decode(&path).unwrap().luma().unwrap();
            assert_eq!(Picture::Eight(read), picture(i));
        }
        assert_eq!(
            std::fs::read_dir(dir.path().join("scan")).unwrap().count(),
            40
        );
    }

    #[test]
    fn a_failure_is_told_and_leaves_whole_files_only() {
        let dir = tempfile::tempdir().unwrap();
        // A file where a folder should be: every write below it fails.
        std::fs::write(dir.path().join("scan"), "").unwrap();
        let mut writer = Writer::new(1, 2).unwrap();
        let mut failure = None;
        for i in 0..200u8 {
            if let Err(e) = writer.push(dir.path().join(format!("scan/{i:03}.png")), picture(i)) {
                failure = Some(e);
                break;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        let failure = failure.expect("must be told").to_string();
        assert!(
            failure.contains("scan/0") && failure.contains("whole"),
            "{failure}"
        );
        assert!(writer.finish().is_err());
    }
}
