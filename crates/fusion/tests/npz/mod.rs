use npyz::npz::NpzArchive;
use npyz::{DType, Deserialize, NpyFile};
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::PathBuf;

/// A reference case: float64 or float32 or integer arrays, read as f64.
pub struct Case(NpzArchive<BufReader<File>>);

impl Case {
    pub fn open(stage: &str, name: &str) -> Self {
        let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/reference");
        Self(NpzArchive::open(root.join(stage).join(format!("{name}.npz"))).unwrap())
    }

    pub fn array(&mut self, key: &str) -> Vec<f64> {
        let file = self.0.by_name(key).unwrap().unwrap_or_else(|| panic!("no key {key}"));
        let DType::Plain(kind) = file.dtype() else { panic!("structured array {key}") };
        match kind.to_string().trim_start_matches(['<', '>', '|', '=']) {
            "f8" => values::<f64, _>(file),
            "f4" => values::<f32, _>(file).into_iter().map(f64::from).collect(),
            "u1" => values::<u8, _>(file).into_iter().map(f64::from).collect(),
            "i8" => values::<i64, _>(file).into_iter().map(|v| v as f64).collect(),
            other => panic!("{key} holds {other}"),
        }
    }

    pub fn scalar(&mut self, key: &str) -> f64 {
        self.array(key)[0]
    }
}

fn values<T: Deserialize, R: Read>(file: NpyFile<R>) -> Vec<T> {
    file.into_vec().unwrap()
}
