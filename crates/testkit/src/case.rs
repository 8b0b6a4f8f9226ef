//! Reference cases: inputs and the results of independent implementations, from `fixtures/reference`.

use ffgs_arrays::NpzFile;
use ffgs_core::{Camera, ImageSize, Intrinsics};
use glam::{DMat3, DMat4, DVec3};
use std::path::{Path, PathBuf};

const REFERENCE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../fixtures/reference");

/// A reference case: inputs, and what an independent float64 implementation made of them.
pub struct Case {
    /// Its arrays.
    pub file: NpzFile,
    /// Name of the file without its ending.
    pub name: String,
}

/// The case `fixtures/reference/STAGE/NAME.npz`.
pub fn case(stage: &str, name: &str) -> Case {
    open(&Path::new(REFERENCE).join(stage).join(format!("{name}.npz")))
}

/// All cases of a stage by name.
pub fn cases(stage: &str) -> Vec<Case> {
    let folder = Path::new(REFERENCE).join(stage);
    let entries = std::fs::read_dir(&folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|ending| ending == "npz"));
    paths.sort();
    assert!(!paths.is_empty(), "no case in {}", folder.display());
    paths.iter().map(|path| open(path)).collect()
}

fn open(path: &Path) -> Case {
    let file = NpzFile::open(path).unwrap_or_else(|e| panic!("{e}"));
    Case { file, name: path.file_stem().unwrap_or_default().to_string_lossy().into_owned() }
}

impl Case {
    /// The values of an array, row-major.
    pub fn array(&self, key: &str) -> Vec<f64> {
        self.file.f64(key).unwrap_or_else(|e| panic!("{}: {e}", self.name)).data
    }

    /// The only, or first, value of an array.
    pub fn scalar(&self, key: &str) -> f64 {
        self.array(key)[0]
    }

    /// Rows of `N` values.
    pub fn rows<const N: usize>(&self, key: &str) -> Vec<[f64; N]> {
        let values = self.array(key);
        let (rows, rest) = values.as_chunks();
        assert!(rest.is_empty(), "{}, {key}: {} values are no rows of {N}", self.name, values.len());
        rows.to_vec()
    }

    /// Rows of three as vectors.
    pub fn points(&self, key: &str) -> Vec<DVec3> {
        self.rows::<3>(key).into_iter().map(DVec3::from).collect()
    }

    /// Row-major 3x3 matrices.
    pub fn matrices(&self, key: &str) -> Vec<DMat3> {
        self.rows::<9>(key).iter().map(|m| DMat3::from_cols_array(m).transpose()).collect()
    }

    /// Cameras of `intrinsics` (fx, fy, cx, cy) and `camera_from_world` (row-major 4x4).
    pub fn cameras(&self, size: ImageSize) -> Vec<Camera> {
        let poses = self.rows::<16>("camera_from_world");
        let camera = |(pose, &[fx, fy, cx, cy]): (&[f64; 16], &[f64; 4])| {
            let pose = DMat4::from_cols_array(pose).transpose();
            Camera::new(Intrinsics { fx, fy, cx, cy }, pose, size).unwrap()
        };
        poses.iter().zip(&self.rows::<4>("intrinsics")).map(camera).collect()
    }
}
