//! Embeds the viewer, `clients/web/dist`, into this crate: see `http/viewer.rs`.
//!
//! `npm run build` makes `dist`. Where it is there and newer than its sources, it is taken as it is, so that
//! whoever builds the front end themselves (a container, the checks of a change) decides how; otherwise npm
//! is run from here, so that `cargo build` alone gives the whole daemon to everyone who has it. Without
//! npm, or without a network at the first build, the build goes on and the daemon says how to get the viewer.

use std::error::Error;
use std::fs::{self, File};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::SystemTime;

/// What the viewer is made of, in `clients/web`.
const SOURCES: [&str; 5] =
    ["client", "viewer", "package.json", "package-lock.json", "vite.config.ts"];

fn main() -> Result<(), Box<dyn Error>> {
    let web = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../clients/web");
    println!("cargo::rerun-if-changed=build.rs");
    for source in SOURCES {
        println!("cargo::rerun-if-changed={}", web.join(source).display());
    }
    let out = PathBuf::from(std::env::var_os("OUT_DIR").ok_or("cargo sets OUT_DIR")?);
    let dist = web.join("dist");
    if let Err(error) = make_current(&web, &dist) {
        println!("cargo::warning=the viewer could not be built: {error}");
        println!("cargo::warning=run `npm ci && npm run build` in clients/web and build again");
        // Tells cargo when somebody has made it.
        fs::create_dir_all(&dist)?;
        println!("cargo::rerun-if-changed={}", dist.display());
    }
    let copies = out.join("viewer");
    let _ = fs::remove_dir_all(&copies);
    fs::create_dir_all(&copies)?;
    fs::write(out.join("viewer.rs"), table(&dist, &copies)?)?;
    Ok(())
}

/// Runs npm unless `dist` is newer than everything it is made of.
fn make_current(web: &Path, dist: &Path) -> Result<(), Box<dyn Error>> {
    // Two builds of one tree take turns.
    let lock = File::open(web.join("package-lock.json"))?;
    lock.lock()?;
    let mut newest = SystemTime::UNIX_EPOCH;
    for source in SOURCES {
        newest = newest.max(newest_file(&web.join(source))?);
    }
    let made = modified(&dist.join("index.html"));
    if made.is_ok_and(|made| made >= newest) {
        return Ok(());
    }
    let installed = modified(&web.join("node_modules/.package-lock.json"));
    if !installed.is_ok_and(|at| modified(&web.join("package-lock.json")).is_ok_and(|l| at >= l)) {
        let quietly = ["--no-audit", "--no-fund", "--ignore-scripts", "--fetch-retries=1"];
        npm(web, &[&["ci"], &quietly[..]].concat())?;
    }
    npm(web, &["run", "build"])
}

fn npm(web: &Path, arguments: &[&str]) -> Result<(), Box<dyn Error>> {
    let output = Command::new("npm")
        .args(arguments)
        .current_dir(web)
        .stdin(Stdio::null())
        .output()
        .map_err(|error| format!("npm cannot be run ({error})"))?;
    if output.status.success() {
        return Ok(());
    }
    let said = String::from_utf8_lossy(&output.stderr);
    let last = said.lines().rfind(|line| !line.trim().is_empty()).unwrap_or("no reason given");
    Err(format!("npm {} failed: {last}", arguments.join(" ")).into())
}

fn modified(path: &Path) -> std::io::Result<SystemTime> {
    fs::metadata(path)?.modified()
}

/// When the youngest file in `path` was changed.
fn newest_file(path: &Path) -> std::io::Result<SystemTime> {
    if !path.is_dir() {
        return modified(path);
    }
    let mut newest = SystemTime::UNIX_EPOCH;
    for entry in fs::read_dir(path)? {
        newest = newest.max(newest_file(&entry?.path())?);
    }
    Ok(newest)
}

/// The Rust expression that lists the files of `dist`, which are copied to `copies`.
fn table(dist: &Path, copies: &Path) -> Result<String, Box<dyn Error>> {
    let mut files = Vec::new();
    for folder in [dist.to_owned(), dist.join("assets")] {
        for entry in fs::read_dir(folder).into_iter().flatten() {
            let path = entry?.path();
            if path.is_file() && path.extension().is_none_or(|extension| extension != "gz") {
                files.push(path);
            }
        }
    }
    files.sort();
    let mut table = String::from("&[\n");
    for path in files {
        let name = path.strip_prefix(dist)?.to_str().ok_or("a file's name is not UTF-8")?;
        let bytes = fs::read(&path)?;
        let mut hasher = DefaultHasher::new();
        bytes.hash(&mut hasher);
        let copy = |content: &[u8], suffix: &str| -> Result<PathBuf, Box<dyn Error>> {
            let copy = copies.join(name.replace('/', "-") + suffix);
            fs::write(&copy, content)?;
            Ok(copy)
        };
        let plain = copy(&bytes, "")?;
        let gzip = match fs::read(format!("{}.gz", path.display())) {
            Ok(content) => format!("Some(include_bytes!({:?}))", copy(&content, ".gz")?),
            Err(_) => "None".to_owned(),
        };
        table += &format!(
            "    File {{ path: {name:?}, tag: \"\\\"{:016x}\\\"\", plain: include_bytes!({plain:?}), \
             gzip: {gzip} }},\n",
            hasher.finish()
        );
    }
    Ok(table + "]\n")
}
