//! Bytes as a file, for readers that go by paths: one file a thread, written anew.

use std::cell::RefCell;
use std::fs::OpenOptions;
use std::io::Write;
use std::path::Path;

use tempfile::TempDir;

thread_local! {
    static FOLDER: RefCell<TempDir> = RefCell::new(TempDir::new().expect("a folder for files"));
}

/// Calls `read` with the path of a file of these bytes, and of another one beside it that may be written.
pub fn with<T>(bytes: &[u8], read: impl FnOnce(&Path, &Path) -> T) -> T {
    FOLDER.with_borrow(|folder| {
        let path = folder.path().join("input");
        let mut file =
            OpenOptions::new().write(true).create(true).truncate(true).open(&path).expect("a file");
        file.write_all(bytes).expect("room for it");
        drop(file);
        read(&path, &folder.path().join("output"))
    })
}
