//! Blobs as files of a local folder.
//!
//! A blob is written to a temporary name beside its own, flushed to the disk (`fsync`) and renamed; then
//! the folder is flushed, so that the name lasts too. An appended part is flushed (`fdatasync`) before
//! the call returns.

use super::{Entry, Storage, StorageError};
use std::fs::{self, File, OpenOptions};
use std::io::{Error, ErrorKind, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Held by the daemon that uses the folder.
const LOCK: &str = "lock";

/// Says whose folder it is, and in which form.
const FORMAT: &str = "format";
const FORMAT_TEXT: &str = "sutura data 1\n";

/// What half-written blobs are called.
const TEMPORARY: &str = ".tmp";

/// A folder of this machine; one process at a time has it.
#[derive(Debug)]
pub struct LocalFiles {
    root: PathBuf,
    /// Locked for as long as it is open.
    _lock: File,
}

impl LocalFiles {
    /// Takes the folder, which is made if there is none, and clears away what was left half-written.
    /// Fails if another process has it, if it cannot be written to, or if its form is not this one.
    pub fn open(root: &Path) -> Result<LocalFiles, StorageError> {
        let failed = |action| {
            move |source| StorageError { action, name: root.display().to_string(), source }
        };
        fs::create_dir_all(root).map_err(failed("creating"))?;
        let lock = OpenOptions::new()
            .create(true)
            .truncate(false)
            .write(true)
            .open(root.join(LOCK))
            .map_err(failed("writing to"))?;
        lock.try_lock().map_err(|error| match error {
            fs::TryLockError::WouldBlock => {
                let source = Error::new(ErrorKind::ResourceBusy, "another daemon uses it");
                failed("opening")(source)
            }
            fs::TryLockError::Error(source) => failed("locking")(source),
        })?;
        let files = LocalFiles { root: root.to_owned(), _lock: lock };
        match files.get(FORMAT)? {
            Some(format) if format == FORMAT_TEXT.as_bytes() => {}
            Some(format) => {
                let found = String::from_utf8_lossy(&format[..format.len().min(64)]).into_owned();
                let source = Error::new(
                    ErrorKind::InvalidData,
                    format!("its form is {found:?}, this version reads {FORMAT_TEXT:?}"),
                );
                return Err(failed("opening")(source));
            }
            None => files.put(FORMAT, FORMAT_TEXT.as_bytes())?,
        }
        for (path, _) in files.files(root)? {
            if path.to_string_lossy().ends_with(TEMPORARY) {
                tracing::info!(path = %path.display(), "a half-written file is cleared away");
                fs::remove_file(&path).map_err(failed("clearing"))?;
            }
        }
        Ok(files)
    }

    fn path(&self, name: &str) -> Result<PathBuf, StorageError> {
        let is_plain = |part: &str| {
            let allowed =
                |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || matches!(c, '-' | '.');
            !part.is_empty() && !part.starts_with('.') && part.chars().all(allowed)
        };
        if name.split('/').all(is_plain) && !name.ends_with(TEMPORARY) {
            return Ok(self.root.join(name));
        }
        let source = Error::new(ErrorKind::InvalidInput, "this is no name of a blob");
        Err(StorageError { action: "naming", name: name.to_owned(), source })
    }

    /// The files below `folder`, with what is known of them.
    fn files(&self, folder: &Path) -> Result<Vec<(PathBuf, fs::Metadata)>, StorageError> {
        let failed = |folder: &Path, source| {
            let name = folder.display().to_string();
            StorageError { action: "listing", name, source }
        };
        let mut pending = vec![folder.to_owned()];
        let mut found = Vec::new();
        while let Some(folder) = pending.pop() {
            let entries = match fs::read_dir(&folder) {
                Ok(entries) => entries,
                Err(error) if error.kind() == ErrorKind::NotFound => continue,
                Err(error) => return Err(failed(&folder, error)),
            };
            for entry in entries {
                let entry = entry.map_err(|error| failed(&folder, error))?;
                let metadata = entry.metadata().map_err(|error| failed(&folder, error))?;
                match metadata.is_dir() {
                    true => pending.push(entry.path()),
                    false => found.push((entry.path(), metadata)),
                }
            }
        }
        Ok(found)
    }
}

fn sync_folder(folder: &Path) -> std::io::Result<()> {
    File::open(folder)?.sync_all()
}

/// Makes a folder whose name lasts.
fn create_folder(folder: &Path) -> std::io::Result<()> {
    if folder.is_dir() {
        return Ok(());
    }
    fs::create_dir_all(folder)?;
    folder.parent().map_or(Ok(()), sync_folder)
}

impl Storage for LocalFiles {
    fn get(&self, name: &str) -> Result<Option<Vec<u8>>, StorageError> {
        match fs::read(self.path(name)?) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
            Err(source) => Err(StorageError { action: "reading", name: name.to_owned(), source }),
        }
    }

    fn put(&self, name: &str, bytes: &[u8]) -> Result<(), StorageError> {
        let path = self.path(name)?;
        let failed = |source| StorageError { action: "writing", name: name.to_owned(), source };
        let folder = path.parent().unwrap_or(&self.root);
        create_folder(folder).map_err(failed)?;
        let mut temporary = path.clone().into_os_string();
        temporary.push(TEMPORARY);
        let write = || {
            let mut file = File::create(&temporary)?;
            file.write_all(bytes)?;
            file.sync_all()?;
            drop(file);
            fs::rename(&temporary, &path)?;
            sync_folder(folder)
        };
        write().map_err(|error| {
            // Room for others; it is cleared away at the next start otherwise.
            let _ = fs::remove_file(&temporary);
            failed(error)
        })
    }

    fn append(&self, name: &str, offset: u64, bytes: &[u8]) -> Result<(), StorageError> {
        let path = self.path(name)?;
        let failed =
            |source| StorageError { action: "appending to", name: name.to_owned(), source };
        let mut file = OpenOptions::new().write(true).open(path).map_err(failed)?;
        let length = file.metadata().map_err(failed)?.len();
        if length < offset {
            let message = format!("it has {length} bytes, {offset} were written");
            return Err(failed(Error::new(ErrorKind::InvalidData, message)));
        }
        let mut write = || {
            if length > offset {
                file.set_len(offset)?;
            }
            file.seek(SeekFrom::Start(offset))?;
            file.write_all(bytes)?;
            file.sync_data()
        };
        write().map_err(|error| {
            // So that nobody who looks later takes it for done. The next call cuts it off in any case.
            let _ = file.set_len(offset).and_then(|()| file.sync_data());
            failed(error)
        })
    }

    fn delete(&self, name: &str) -> Result<(), StorageError> {
        let path = self.path(name)?;
        let failed = |source| StorageError { action: "deleting", name: name.to_owned(), source };
        match fs::remove_file(&path) {
            Ok(()) => path.parent().map_or(Ok(()), sync_folder).map_err(failed),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
            Err(error) => Err(failed(error)),
        }
    }

    fn list(&self, prefix: &str) -> Result<Vec<Entry>, StorageError> {
        let files = self.files(&self.path(prefix)?)?;
        let mut entries: Vec<Entry> = files
            .into_iter()
            .filter_map(|(path, metadata)| {
                let name = path.strip_prefix(&self.root).ok()?.to_str()?.to_owned();
                let (modified, n_bytes) = (metadata.modified().ok(), metadata.len());
                (!name.ends_with(TEMPORARY)).then_some(Entry { name, modified, n_bytes })
            })
            .collect();
        entries.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(entries)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(files: &LocalFiles, prefix: &str) -> Vec<String> {
        files.list(prefix).unwrap().into_iter().map(|entry| entry.name).collect()
    }

    #[test]
    fn blobs_are_put_replaced_appended_to_listed_and_deleted() {
        let folder = tempfile::tempdir().unwrap();
        let files = LocalFiles::open(folder.path()).unwrap();
        assert_eq!(files.get("a/1").unwrap(), None);
        files.put("a/1", b"one").unwrap();
        files.put("a/2", b"two").unwrap();
        files.put("a/1", b"uno").unwrap();
        files.append("a/1", 3, b" due").unwrap();
        // What a call that failed has left is cut off.
        files.append("a/1", 4, b"tre").unwrap();
        assert_eq!(files.get("a/1").unwrap().unwrap(), b"uno tre");
        assert_eq!(names(&files, "a"), ["a/1", "a/2"]);
        assert_eq!(names(&files, "b"), [""; 0]);
        files.delete("a/1").unwrap();
        files.delete("a/1").unwrap();
        assert_eq!(names(&files, "a"), ["a/2"]);
        // Nothing comes to be by appending, and nothing is left out.
        assert!(files.append("a/1", 0, b"x").is_err());
        assert!(files.append("a/2", 4, b"x").is_err());
    }

    #[test]
    fn names_stay_inside_the_folder() {
        let folder = tempfile::tempdir().unwrap();
        let files = LocalFiles::open(folder.path()).unwrap();
        for name in ["", "..", "../x", "/x", "a//b", "a/.b", "A", "a b", "x.tmp"] {
            assert!(files.put(name, b"").is_err(), "{name:?}");
        }
    }

    #[test]
    fn a_folder_belongs_to_one_process_and_one_form() {
        let folder = tempfile::tempdir().unwrap();
        let first = LocalFiles::open(folder.path()).unwrap();
        let refused = LocalFiles::open(folder.path()).unwrap_err().to_string();
        assert!(refused.contains("another daemon"), "{refused}");
        first.put("a/1", b"one").unwrap();
        drop(first);

        fs::write(folder.path().join("a/2.tmp"), b"half").unwrap();
        let second = LocalFiles::open(folder.path()).unwrap();
        assert!(!folder.path().join("a/2.tmp").exists());
        assert_eq!(names(&second, "a"), ["a/1"]);
        drop(second);

        fs::write(folder.path().join("format"), b"sutura data 9\n").unwrap();
        let refused = LocalFiles::open(folder.path()).unwrap_err().to_string();
        assert!(refused.contains("sutura data 9"), "{refused}");
    }
}
