//! Damaged runs that are exported, and damaged streams that are gone on with, decoded and served.

use super::capture::copy_folder;
use super::case::{Case, names_a_file, said};
use super::checksum::crc32;
use super::inputs::{change, damaged_file_of_run, stays_inside};
use anyhow::{Context, Result, bail, ensure};
use serde_json::{Value, json};
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::Child;
use std::time::Duration;

const FORMATS: [&str; 6] = ["stream", "ply-seq", "compressed-ply-seq", "spz", "sog", "glb"];
/// Longest wait for an answer (s).
const PATIENCE: u64 = 60;

/// A damaged run as files for players.
pub(crate) fn damaged_export(case: &mut Case) -> Result<()> {
    let run = damaged_file_of_run(case)?;
    let format = case.one_of(&FORMATS);
    let path = run.display().to_string();
    let mut words =
        ["export", &path, "--to", format, "--frames", "0..2", "--quiet"].map(str::to_owned).to_vec();
    if format != "stream" {
        words.push("--native".to_owned());
    }
    let ended = case.ffgs(&words)?;
    ensure!(ended.status.success() || names_a_file(case, &said(&ended)), "which file? {}", said(&ended));
    stays_inside(case)
}

/// A damaged stream: gone on with and decoded, or served to a visitor who asks for what lies outside.
pub(crate) fn damaged_stream(case: &mut Case) -> Result<()> {
    let (run, stream) = (case.laboratory.run(), case.path("out"));
    copy_folder(&sound_stream(case, &run)?, &stream)?;
    damage_stream(case, &stream)?;
    let paths = [&run, &stream].map(|path| path.display().to_string());
    if case.below(3) == 0 {
        return serve(case, &stream);
    }
    let words = ["export", &paths[0], "--to", "stream", "--out", &paths[1], "--measure", "--quiet"];
    let ended = case.ffgs(&words.map(str::to_owned))?;
    ensure!(ended.status.success() || names_a_file(case, &said(&ended)), "which file? {}", said(&ended));
    stays_inside(case)
}

/// The stream of the undisturbed run's first two frames.
fn sound_stream(case: &mut Case, run: &Path) -> Result<PathBuf> {
    let laboratory = case.laboratory;
    laboratory.shared("stream", |folder| {
        let paths = [run, folder].map(|path| path.display().to_string());
        let words =
            ["export", &paths[0], "--to", "stream", "--out", &paths[1], "--frames", "0..2", "--quiet"];
        let ended = case.ffgs(&words.map(str::to_owned))?;
        ensure!(ended.status.success(), "cannot export: {}", said(&ended));
        Ok(())
    })
}

fn damage_stream(case: &mut Case, stream: &Path) -> Result<()> {
    let pool = super::capture::files(stream)?;
    let file = case.one_of(&pool);
    change(case, &file)?;
    let is_frame = file.extension().is_some_and(|extension| extension == "4df");
    if is_frame && case.below(4) > 0 { mend_checksums(stream, &file) } else { Ok(()) }
}

/// Makes the checksum at the end of a frame's file that of the damaged bytes, and its line in the list too.
fn mend_checksums(stream: &Path, file: &Path) -> Result<()> {
    let mut bytes = fs::read(file)?;
    bytes.resize(bytes.len().max(12), 0);
    let end = bytes.len() - 4;
    let sum = crc32(&bytes[..end]);
    bytes[end..].copy_from_slice(&sum.to_le_bytes());
    fs::write(file, &bytes)?;
    let list = stream.join("frames.jsonl");
    let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let mended = |line: &str| -> Result<String> {
        let mut entry: Value = serde_json::from_str(line)?;
        if entry["file"] == json!(name) {
            (entry["crc32"], entry["bytes"]) = (json!(sum), json!(bytes.len()));
        }
        Ok(format!("{entry}\n"))
    };
    let lines: String = fs::read_to_string(&list)?.lines().map(mended).collect::<Result<_>>()?;
    fs::write(list, lines).context("cannot write the list")
}

/// Serves the stream and asks for files of it, for files outside of it and for nonsense.
fn serve(case: &mut Case, stream: &Path) -> Result<()> {
    // The page's engine does not matter here: any file does.
    let mut command = case.limited("", &["view".to_owned(), stream.display().to_string()]);
    command.env("FFGS_PLAYCANVAS", case.laboratory.capture().join("train_meta.json"));
    let secret = stream.join("../secret");
    fs::write(&secret, "SECRET").context("cannot write")?;
    let mut child = command.spawn().context("cannot start the program")?;
    let visited = visit(&mut child);
    let ended = child.try_wait()?;
    child.kill().context("cannot stop the program")?;
    let said = said(&child.wait_with_output()?);
    fs::remove_file(secret)?;
    ensure!(!said.contains("panicked at"), "a panic: {said}");
    match ended {
        None => visited,
        Some(status) if said.contains("error: ") => ensure_refused(status.code()),
        Some(status) => bail!("ended with {status}: {said}"),
    }
}

fn ensure_refused(code: Option<i32>) -> Result<()> {
    ensure!(code == Some(1), "ended with status {code:?}");
    Ok(())
}

fn visit(child: &mut Child) -> Result<()> {
    let mut url = String::new();
    BufReader::new(child.stdout.as_mut().context("no output")?).read_line(&mut url)?;
    let Some((host, token)) = url.trim().trim_start_matches("http://").split_once('/') else { return Ok(()) };
    for path in ["manifest.json", "frames.jsonl", "index.html"] {
        ask(host, &format!("GET /{token}{path} HTTP/1.1"), Some("bytes=0-9"))?;
    }
    let outside = [
        "../secret",
        "%2e%2e/secret",
        "..%2fsecret",
        "./../secret",
        "/etc/passwd",
        "..\\secret",
        "a/../../secret",
    ];
    for path in outside {
        let answer = ask(host, &format!("GET /{token}{path} HTTP/1.1"), None)?;
        ensure!(!answer.contains("SECRET") && !answer.contains("root:"), "{path} was served");
    }
    let ranges = [
        "bytes=18446744073709551615-",
        "bytes=9-1",
        "bytes=-18446744073709551616",
        "bytes=0-18446744073709551615",
    ];
    for range in ranges {
        ask(host, &format!("GET /{token}manifest.json HTTP/1.1"), Some(range))?;
    }
    for request in
        ["GET", "POST / HTTP/1.1", "GET / HTTP/9.9", &format!("GET /{} HTTP/1.1", "a".repeat(1 << 16))]
    {
        ask(host, request, None)?;
    }
    let answer = ask(host, &format!("GET /{token} HTTP/1.1"), None)?;
    ensure!(answer.starts_with("HTTP/1.1 200"), "no answer after all that: {answer:?}");
    Ok(())
}

/// What a server answers to one request; nothing when it hangs up.
fn ask(host: &str, request: &str, range: Option<&str>) -> Result<String> {
    let mut stream = TcpStream::connect(host).context("the server is gone")?;
    stream.set_read_timeout(Some(Duration::from_secs(PATIENCE)))?;
    let range = range.map(|range| format!("Range: {range}\r\n")).unwrap_or_default();
    let mut answer = Vec::new();
    // A server that hangs up on nonsense is within its rights.
    let _ =
        stream.write_all(format!("{request}\r\nHost: {host}\r\n{range}Connection: close\r\n\r\n").as_bytes());
    match stream.read_to_end(&mut answer) {
        Err(error)
            if [std::io::ErrorKind::WouldBlock, std::io::ErrorKind::TimedOut].contains(&error.kind()) =>
        {
            bail!("no answer to {request:?} after {PATIENCE} s")
        }
        _ => Ok(String::from_utf8_lossy(&answer).into_owned()),
    }
}
