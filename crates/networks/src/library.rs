//! ONNX Runtime, loaded once per process.

use crate::NetworkError;
use ort::environment::Environment;
use std::env;
use std::path::PathBuf;
use std::sync::OnceLock;

/// Names the library; the same variable that other programs use.
const VARIABLE: &str = "ORT_DYLIB_PATH";

#[cfg(windows)]
const NAMES: [&str; 1] = ["onnxruntime.dll"];
#[cfg(target_os = "macos")]
const NAMES: [&str; 1] = ["libonnxruntime.dylib"];
#[cfg(not(any(windows, target_os = "macos")))]
const NAMES: [&str; 2] = ["libonnxruntime.so", "libonnxruntime.so.1"];

/// The environment of all sessions, from the library that `ORT_DYLIB_PATH` names, or else the system's.
pub(crate) fn environment() -> Result<&'static Environment, NetworkError> {
    static LOADED: OnceLock<Result<Environment, String>> = OnceLock::new();
    LOADED.get_or_init(load).as_ref().map_err(|reason| NetworkError::Library(reason.clone()))
}

fn load() -> Result<Environment, String> {
    let named = env::var_os(VARIABLE).filter(|value| !value.is_empty());
    let candidates: Vec<PathBuf> = match &named {
        // A relative path would be looked for beside the program.
        Some(file) => vec![std::path::absolute(file).map_err(|e| format!("{VARIABLE}: {e}"))?],
        None => NAMES.iter().map(PathBuf::from).collect(),
    };
    let mut reasons = Vec::new();
    for candidate in candidates {
        match ort::init_from(&candidate).map_err(|e| e.to_string()) {
            Ok(builder) => return builder.with_name("ffgs").build().map_err(|e| e.to_string()),
            Err(reason) => reasons.push(reason),
        }
    }
    if named.is_none() {
        reasons.push(format!("{VARIABLE} is not set"));
    }
    Err(reasons.join("; "))
}
