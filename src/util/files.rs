//! Safe files: atomic replacement, checksums, bounded reading.

use std::fs::{self, File, Permissions};
use std::io::{self, BufRead, BufWriter, Read, Write};
use std::os::unix::fs::{FileTypeExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use sha2::{Digest, Sha256};

/// An error about a file: it cannot be read or written, or has the wrong content.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{what} {}: {problem}", path.display())]
pub struct FileError {
    /// The expected kind of file, such as `policy`.
    pub what: &'static str,
    /// Path of the file.
    pub path: PathBuf,
    /// Reason given by the operating system, or what was found and what was expected.
    pub problem: String,
}

impl FileError {
    /// Returns a function that creates the error from a reason.
    pub fn of<E: ToString>(what: &'static str, path: &Path) -> impl Fn(E) -> Self + Copy {
        move |problem| FileError { what, path: path.to_owned(), problem: problem.to_string() }
    }
}

/// Explains why a file that Supple wrote cannot be read, if `reason` is that it has an unknown key or value.
pub(crate) fn of_another_version(reason: &str) -> Option<String> {
    let (unknown, _) = reason.split_once("`, ").filter(|(unknown, _)| unknown.contains("unknown "))?;
    Some(format!("{unknown}`: another version of Supple wrote this file; use that version, or remove the key"))
}

/// Writes a file so that at any moment, even after a power failure, either the old or the new content is on disk: a
/// temporary file next to it, synced, renamed over it, and the folder synced. See [`write_with`] for devices and pipes.
///
/// # Errors
/// The operating system cannot write the file; the old content is then unchanged.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> io::Result<()> {
    write_with(path, |out| out.write_all(bytes))
}

/// Writes a file like [`write_atomically`], in pieces. A link is kept and its target written; a device or a pipe is
/// written to and never replaced; `-` and `/dev/stdout` are standard output, where a closed pipe is no error.
///
/// # Errors
/// The operating system or `write` fails; the old content of a regular file is then unchanged.
pub fn write_with(path: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
    match Target::of(path)? {
        Target::File(path) => replace(&path, write, || Ok(())),
        Target::Stream(path) => {
            File::options().append(true).open(path).and_then(|file| buffered(file, write).map(drop))
        }
        Target::Output => match buffered(io::stdout().lock(), write) {
            Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
            written => written.map(drop),
        },
    }
}

/// Writes a new file in pieces. It appears when it is whole, and never in place of another one.
///
/// # Errors
/// There is a file of this name already, or the operating system or `write` fails.
pub fn write_new(path: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
    let (file, temporary) = temporary_for(path)?;
    buffered(file, write)?.sync_all()?;
    temporary.persist_noclobber(path).map_err(|error| error.error)?;
    sync_folder(path)
}

fn buffered<W: Write>(out: W, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<W> {
    let mut out = BufWriter::new(out);
    write(&mut out)?;
    let mut out = out.into_inner().map_err(io::IntoInnerError::into_error)?;
    out.flush()?;
    Ok(out)
}

/// Writes a file like [`write_atomically`] that is never a link, and keeps the previous content as `old`. At any moment
/// one of the two is complete.
pub(crate) fn write_keeping(path: &Path, old: &Path, bytes: &[u8]) -> io::Result<()> {
    let keep = || match fs::rename(path, old) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    };
    replace(path, |out| out.write_all(bytes), keep)
}

/// Writes a temporary file next to `path`, calls `before`, and renames the file. Its name cannot be guessed, and it is
/// always newly created, so that it cannot be a link placed there before.
fn replace(
    path: &Path,
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    before: impl FnOnce() -> io::Result<()>,
) -> io::Result<()> {
    let (file, temporary) = temporary_for(path)?;
    if let Ok(old) = fs::metadata(path) {
        file.set_permissions(old.permissions())?;
    }
    let file = buffered(file, write)?;
    file.sync_all()?;
    before()?;
    temporary.persist(path).map_err(|error| error.error)?;
    sync_folder(path)
}

/// Creates a temporary file next to `path`.
fn temporary_for(path: &Path) -> io::Result<(File, tempfile::TempPath)> {
    let new = Permissions::from_mode(0o666);
    let mut temporary = tempfile::Builder::new();
    let temporary = temporary.prefix(TEMPORARY.0).suffix(TEMPORARY.1).rand_bytes(16).permissions(new);
    let (file, temporary) = temporary.tempfile_in(folder_of(path))?.into_parts();
    // Until it has its name: it is not left over. Where the file system knows no locks, none is ever cleared.
    let _ = file.lock();
    Ok((file, temporary))
}

/// Start and end of the names of temporary files.
const TEMPORARY: (&str, &str) = (".supple-", ".tmp");

/// Removes temporary files that killed processes left in a folder, but not those being written.
///
/// # Errors
/// The folder cannot be read, or a file cannot be removed.
pub fn clear_temporaries(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let name = entry.file_name();
        let name = name.to_string_lossy();
        if name.starts_with(TEMPORARY.0) && name.ends_with(TEMPORARY.1) && entry.file_type()?.is_file() {
            // Else it is being written, or has got its name meanwhile.
            let Some(_left_over) = File::open(entry.path()).ok().filter(|file| file.try_lock().is_ok()) else {
                continue;
            };
            fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

/// The destination of written data.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Target {
    /// A regular file, existing or new; no link.
    File(PathBuf),
    /// A device or a pipe, or another name of an open file.
    Stream(PathBuf),
    /// Standard output.
    Output,
}

impl Target {
    /// Resolves a path given by a user.
    ///
    /// # Errors
    /// The path cannot be resolved, or is a folder.
    pub fn of(path: &Path) -> io::Result<Self> {
        if path == Path::new("-") {
            return Ok(Target::Output);
        }
        ensure!(path.file_name().is_some(), io::Error::new(io::ErrorKind::InvalidInput, "it names no file"));
        let mut path = path.to_owned();
        for _ in 0..MAX_LINKS {
            let kind = match fs::symlink_metadata(&path) {
                Ok(found) => found.file_type(),
                Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Target::File(path)),
                Err(error) => return Err(error),
            };
            ensure!(!kind.is_dir(), io::Error::new(io::ErrorKind::IsADirectory, "it is a folder, expected a file"));
            if !kind.is_symlink() {
                return Ok(if kind.is_file() { Target::File(path) } else { Target::Stream(path) });
            }
            let folder = fs::canonicalize(folder_of(&path))?;
            if folder.starts_with("/proc") {
                let ours = Path::new("/proc").join(std::process::id().to_string()).join("fd/1");
                return Ok(if folder.join(path.file_name().unwrap_or_default()) == ours {
                    Target::Output
                } else {
                    Target::Stream(path)
                });
            }
            path = folder.join(fs::read_link(&path)?);
        }
        Err(io::Error::other("it is a link that leads nowhere"))
    }
}

/// Maximum length of a chain of links, as in the operating system.
const MAX_LINKS: usize = 40;

/// Returns the folder of a path.
fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Syncs the folder of `path`, so that renames in it survive a power failure.
pub(crate) fn sync_folder(path: &Path) -> io::Result<()> {
    File::open(folder_of(path))?.sync_all()
}

/// True if [`open`] refuses pipes.
static REFUSES_PIPES: AtomicBool = AtomicBool::new(false);

/// Makes this program refuse to read pipes, which may never end: for programs that others may ask for files.
pub fn refuse_pipes() {
    REFUSES_PIPES.store(true, Ordering::Relaxed);
}

/// Opens a file, or a pipe unless [`refuse_pipes`] was called, for reading.
///
/// # Errors
/// The file cannot be read, is a folder, or is a device, which may have no end.
pub fn open(path: &Path) -> io::Result<File> {
    // Checked first, because opening a pipe waits for a writer.
    let kind = fs::metadata(path)?.file_type();
    let found = if kind.is_dir() {
        "a folder"
    } else if kind.is_char_device() || kind.is_block_device() {
        "a device"
    } else if REFUSES_PIPES.load(Ordering::Relaxed) && (kind.is_fifo() || kind.is_socket()) {
        "a pipe"
    } else {
        return File::open(path);
    };
    Err(io::Error::new(io::ErrorKind::InvalidInput, format!("it is {found}, expected a file")))
}

/// Reads a file, or a pipe to its end, of at most `limit` bytes.
///
/// # Errors
/// The file cannot be read, is larger than `limit`, or is a device, which may have no end.
pub fn read_bounded(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    let file = open(path)?;
    let found = file.metadata()?;
    let mut bytes = Vec::new();
    // What is no regular file says that it has 0 bytes.
    if found.len() <= limit {
        file.take(limit.saturating_add(1)).read_to_end(&mut bytes)?;
    }
    if found.len().max(bytes.len() as u64) > limit {
        let message = format!("it has more than the {limit} bytes that such a file can have");
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, message));
    }
    Ok(bytes)
}

/// Reads UTF-8 text like [`read_bounded`], and removes a leading byte-order mark.
///
/// # Errors
/// The file cannot be read, is larger than `limit`, is a device, or is not UTF-8.
pub fn read_text(path: &Path, limit: u64) -> io::Result<String> {
    utf8(read_bounded(path, limit)?)
}

/// Iterates over lines of at most `limit` bytes, without line ends.
pub fn lines(mut reader: impl BufRead, limit: u64) -> impl Iterator<Item = io::Result<String>> {
    std::iter::from_fn(move || {
        let mut line = Vec::new();
        match (&mut reader).take(limit.saturating_add(1)).read_until(b'\n', &mut line) {
            Err(error) => return Some(Err(error)),
            Ok(0) => return None,
            Ok(_) if line.ends_with(b"\n") => drop(line.pop()),
            Ok(length) if length as u64 > limit => {
                let message = format!("it has more than the {limit} bytes that a line can have");
                return Some(Err(io::Error::new(io::ErrorKind::FileTooLarge, message)));
            }
            Ok(_) => {}
        }
        Some(utf8(line))
    })
}

/// Returns a text or line without its byte order mark.
fn utf8(mut bytes: Vec<u8>) -> io::Result<String> {
    if bytes.starts_with("\u{feff}".as_bytes()) {
        bytes.drain(..3);
    }
    String::from_utf8(bytes).map_err(|_| io::Error::new(io::ErrorKind::InvalidData, "it is not text in UTF-8"))
}

/// Returns true if a path has the extension of a YAML file.
pub fn is_yaml(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "yaml" || extension == "yml")
}

/// Returns the SHA-256 of the parts in hexadecimal.
pub fn sha256(parts: &[&[u8]]) -> String {
    let mut hasher = Sha256::new();
    for part in parts {
        hasher.update(part);
    }
    hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_leaves_the_old_content() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("kept");
        write_atomically(&path, b"old").unwrap();
        let failed = write_with(&path, |out| {
            out.write_all(b"half")?;
            Err(io::Error::other("disk full"))
        });
        assert!(failed.is_err());
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "a temporary file is left");
    }

    #[test]
    fn new_file_replaces_none() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new");
        write_new(&path, |out| out.write_all(b"first")).unwrap();
        let again = write_new(&path, |out| out.write_all(b"second"));
        assert_eq!(again.unwrap_err().kind(), io::ErrorKind::AlreadyExists);
        assert_eq!(fs::read(&path).unwrap(), b"first");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "a temporary file is left");
    }

    #[test]
    fn links_and_permissions_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::create_dir(at("far")).unwrap();
        fs::write(at("far/file"), "old").unwrap();
        fs::set_permissions(at("far/file"), Permissions::from_mode(0o640)).unwrap();
        for (link, to) in [("one", "far/file"), ("two", "one"), ("new", "far/new")] {
            std::os::unix::fs::symlink(to, at(link)).unwrap();
        }
        write_atomically(&at("two"), b"2").unwrap();
        write_atomically(&at("new"), b"new").unwrap();
        let text = |name: &str| fs::read_to_string(at(name)).unwrap();
        assert_eq!((text("far/file"), text("far/new")), ("2".into(), "new".into()));
        assert!(["one", "two", "new"].iter().all(|link| at(link).is_symlink()));
        assert_eq!(fs::metadata(at("far/file")).unwrap().permissions().mode() & 0o777, 0o640);
        fs::write(at("plain"), "").unwrap();
        let [plain, ours] = ["plain", "far/new"].map(|name| fs::metadata(at(name)).unwrap().permissions().mode());
        assert_eq!(plain, ours, "a new file has the permissions that any program gives it");
    }

    #[test]
    fn devices_and_pipes_are_written_to_and_not_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let (pipe, link) = (folder.path().join("pipe"), folder.path().join("full"));
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let read = std::thread::spawn({
            let pipe = pipe.clone();
            move || fs::read(pipe).unwrap()
        });
        write_atomically(&pipe, b"through").unwrap();
        assert_eq!(read.join().unwrap(), b"through");
        std::os::unix::fs::symlink("/dev/full", &link).unwrap();
        assert_eq!(write_atomically(&link, b"x").unwrap_err().kind(), io::ErrorKind::StorageFull);
        assert!(link.is_symlink() && fs::metadata("/dev/full").unwrap().file_type().is_char_device());
        for name in ["-", "/dev/stdout", "/proc/self/fd/1"] {
            assert_eq!(Target::of(Path::new(name)).unwrap(), Target::Output, "{name}");
        }
    }

    #[test]
    fn temporary_files_of_killed_processes_are_cleared_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for name in [".supple-abc.tmp", "mine.tmp", "checkpoint"] {
            fs::write(at(name), "").unwrap();
        }
        write_with(&at("written"), |out| {
            clear_temporaries(folder.path())?;
            out.write_all(b"whole")
        })
        .unwrap();
        assert_eq!(fs::read(at("written")).unwrap(), b"whole");
        assert!(!at(".supple-abc.tmp").exists() && at("mine.tmp").exists() && at("checkpoint").exists());
    }

    #[test]
    fn what_has_no_end_is_refused_after_the_limit() {
        let folder = tempfile::tempdir().unwrap();
        let (pipe, file) = (folder.path().join("pipe"), folder.path().join("file"));
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        // Fails to write all of it, since the reader goes away.
        let write = std::thread::spawn({
            let pipe = pipe.clone();
            move || fs::write(pipe, vec![b'a'; 1 << 20])
        });
        assert_eq!(read_bounded(&pipe, 1000).unwrap_err().kind(), io::ErrorKind::FileTooLarge);
        assert!(write.join().unwrap().is_err());
        assert!(read_bounded(Path::new("/dev/zero"), 1000).unwrap_err().to_string().contains("a device"));
        assert!(read_bounded(folder.path(), 1000).unwrap_err().to_string().contains("a folder"));
        fs::write(&file, "\u{feff}abc").unwrap();
        assert_eq!(read_text(&file, 6).unwrap(), "abc");
        assert_eq!(read_bounded(&file, 5).unwrap_err().kind(), io::ErrorKind::FileTooLarge);
    }

    #[test]
    fn lines_are_bounded() {
        assert!(lines(&b"longer"[..], 5).next().unwrap().is_err());
        assert!(lines(&b"longer\n"[..], 5).next().unwrap().is_err());
        let all: Vec<_> = lines(&b"one\n\nthree"[..], 5).map(Result::unwrap).collect();
        assert_eq!(all, ["one", "", "three"]);
        let endless = io::BufReader::new(io::repeat(b'a'));
        assert_eq!(lines(endless, 6).next().unwrap().unwrap_err().kind(), io::ErrorKind::FileTooLarge);
    }

    #[test]
    fn sha256_of_abc_is_the_standards() {
        // FIPS 180-2, appendix B.1
        let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(sha256(&[b"a", b"bc"]), expected);
    }
}
