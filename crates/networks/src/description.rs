//! What a network takes and gives, as TOML.

use crate::NetworkError;
use ffgs_core::{TrackerLevel, read_text};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// Descriptions that come with the program: name and text. Networks do not come with it.
pub const SHIPPED: [(&str, &str); 2] = [
    ("raft", include_str!("../descriptions/raft.toml")),
    ("xfeat", include_str!("../descriptions/xfeat.toml")),
];

/// A description has some thirty lines.
const MAX_BYTES: u64 = 1 << 16;

/// A network: its file, its inputs, and one of two kinds of output.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Description {
    /// Name of the tracker, and of its folder below `tracks/`.
    pub name: String,
    /// The ONNX file, relative to the description.
    pub model: PathBuf,
    /// How densely it covers the image; dense for flow and sparse for matches when left out.
    pub level: Option<TrackerLevel>,
    /// The two pictures.
    pub input: Input,
    /// For networks that give a displacement for every pixel.
    pub flow: Option<FlowOutput>,
    /// For networks that give pairs of points.
    pub matches: Option<MatchOutput>,
}

/// How two pictures become tensors: `(value - subtract) / divide` of values from 0 to 255.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Input {
    /// Names of the inputs: those of the earlier and the later picture, or one for both.
    pub names: Vec<String>,
    /// How one input holds both.
    #[serde(default)]
    pub join: Join,
    /// Order of the dimensions.
    #[serde(default)]
    pub layout: Layout,
    /// Order of the channels.
    #[serde(default)]
    pub colour: Colour,
    /// Per channel in the order of `colour`.
    #[serde(default)]
    pub subtract: [f32; 3],
    /// Per channel in the order of `colour`.
    #[serde(default = "ones")]
    pub divide: [f32; 3],
    /// Pictures are continued to the right and below up to multiples of this (px).
    #[serde(default = "one")]
    pub multiple: usize,
    /// Pictures are brought to this width and height (px); that of the network when it has a fixed size.
    pub size: Option<[usize; 2]>,
}

/// How one input holds two pictures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Join {
    /// (1, 6, H, W).
    #[default]
    Channels,
    /// (2, 3, H, W).
    Batch,
}

/// Order of the dimensions of a tensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Layout {
    /// Batch, channel, row, column.
    #[default]
    Nchw,
    /// Batch, row, column, channel.
    Nhwc,
}

/// Channels of a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Colour {
    /// Red, green, blue.
    #[default]
    Rgb,
    /// Blue, green, red, as OpenCV has them.
    Bgr,
    /// One channel.
    Grey,
}

/// A displacement (px of the network's picture) for every pixel of the earlier picture.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FlowOutput {
    /// Name of the output.
    pub output: String,
    /// Order of its dimensions.
    #[serde(default)]
    pub layout: Layout,
}

/// Pairs of points.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MatchOutput {
    /// Output with positions in the earlier picture, (N, 2) px.
    pub first: String,
    /// Output with positions in the later picture, (M, 2) px.
    pub second: String,
    /// Output with the pairs: (N) with the index in `second` or -1, or (K, 2), or (K, 3) with the batch first. Without
    /// it the rows of `first` and `second` belong together.
    pub indices: Option<String>,
    /// Output with a score per pair, (K), or per position of `first`, (N).
    pub scores: Option<String>,
    /// Pairs with a lower score are left out.
    #[serde(default)]
    pub least_score: f32,
    /// Where the centre of the first pixel lies: 0 (integer) or 0.5 (half).
    #[serde(default)]
    pub pixel_center: Center,
}

/// Where the centre of the first pixel lies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Center {
    /// (0, 0).
    #[default]
    Integer,
    /// (0.5, 0.5).
    Half,
}

fn ones() -> [f32; 3] {
    [1.0; 3]
}

fn one() -> usize {
    1
}

impl Description {
    /// Reads `FILE.toml`, or a shipped description with its network as `NAME=MODEL.onnx`.
    ///
    /// # Errors
    /// When the file cannot be read, a key is unknown or a value is impossible.
    pub fn of(argument: &str) -> Result<Self, NetworkError> {
        match argument.split_once('=') {
            Some((name, model)) => Self::shipped(name, Path::new(model)),
            None => Self::read(Path::new(argument)),
        }
    }

    fn shipped(name: &str, model: &Path) -> Result<Self, NetworkError> {
        let found = SHIPPED.iter().find(|(known, _)| *known == name);
        let (_, text) = found.ok_or_else(|| {
            let known = SHIPPED.map(|(name, _)| name).join(", ");
            let reason = format!("no description of that name comes with the program; there are {known}");
            NetworkError::description(Path::new(name), reason)
        })?;
        Ok(Self { model: model.to_owned(), ..Self::parse(text, Path::new(name))? })
    }

    fn read(file: &Path) -> Result<Self, NetworkError> {
        let text = read_text(file, MAX_BYTES).map_err(|e| NetworkError::description(file, e.to_string()))?;
        let out = Self::parse(&text, file)?;
        let model = file.parent().unwrap_or(Path::new("")).join(&out.model);
        Ok(Self { model, ..out })
    }

    fn parse(text: &str, file: &Path) -> Result<Self, NetworkError> {
        let out: Self =
            toml::from_str(text).map_err(|e| NetworkError::description(file, e.to_string().trim_end()))?;
        match out.fault() {
            Some(reason) => Err(NetworkError::description(file, reason)),
            None => Ok(out),
        }
    }

    /// What contradicts itself.
    fn fault(&self) -> Option<String> {
        let input = &self.input;
        let finite = input.subtract.iter().chain(&input.divide).all(|v| v.is_finite());
        let sides = [input.multiple].into_iter().chain(input.size.into_iter().flatten());
        let faults = [
            (
                self.name.is_empty()
                    || self.name.starts_with('.')
                    || self.name.contains(['/', '\\', '{', '}']),
                "name: it must be usable as the name of a folder",
            ),
            (
                self.flow.is_some() == self.matches.is_some(),
                "it must have one of the tables [flow] and [matches]",
            ),
            (
                !(1..=2).contains(&input.names.len()),
                "input.names: the names of the two pictures' inputs, or one for both",
            ),
            (
                !finite || input.divide.contains(&0.0),
                "input.subtract and input.divide must be finite, and divide not 0",
            ),
            (
                sides.into_iter().any(|side| side == 0 || side > 1 << 14),
                "input.multiple and input.size: 1 to 16384 px",
            ),
        ];
        faults.into_iter().find(|(is_wrong, _)| *is_wrong).map(|(_, reason)| reason.to_owned())
    }

    /// How densely the network covers the image.
    pub fn level(&self) -> TrackerLevel {
        let usual = if self.flow.is_some() { TrackerLevel::Dense } else { TrackerLevel::Sparse };
        self.level.unwrap_or(usual)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FLOW: &str = "name = 'n'\nmodel = 'n.onnx'\n[input]\nnames = ['a', 'b']\n[flow]\noutput = 'f'\n";

    fn message(text: &str) -> String {
        Description::parse(text, Path::new("n.toml")).unwrap_err().to_string()
    }

    #[test]
    fn the_shipped_ones_can_be_read() {
        for (name, _) in SHIPPED {
            let description = Description::of(&format!("{name}=/there/net.onnx")).unwrap();
            assert_eq!((description.name.as_str(), description.model), (name, "/there/net.onnx".into()));
        }
        assert_eq!(Description::of("raft=m").unwrap().level(), TrackerLevel::Dense);
        assert_eq!(Description::of("xfeat=m").unwrap().level(), TrackerLevel::Sparse);
        let unknown = Description::of("gmflow=m").unwrap_err().to_string();
        assert!(unknown.contains("raft, xfeat"), "{unknown}");
    }

    #[test]
    fn a_model_lies_beside_its_description() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("n.toml");
        std::fs::write(&file, FLOW).unwrap();
        let read = Description::of(&file.display().to_string()).unwrap();
        assert_eq!(read.model, folder.path().join("n.onnx"));
    }

    #[test]
    fn contradictions_are_named() {
        assert!(Description::parse(FLOW, Path::new("n.toml")).is_ok());
        assert!(message(&FLOW.replace("[flow]", "[flows]")).contains("flows"));
        assert!(message(&FLOW.replace("[flow]\noutput = 'f'\n", "")).contains("[flow] and [matches]"));
        assert!(message(&FLOW.replace("'a', 'b'", "'a', 'b', 'c'")).contains("input.names"));
        assert!(message(&FLOW.replace("[flow]", "divide = [1, 0, 1]\n[flow]")).contains("divide"));
        assert!(message(&FLOW.replace("[flow]", "multiple = 0\n[flow]")).contains("multiple"));
        assert!(message(&FLOW.replace("'n'", "'../n'")).contains("folder"));
        assert!(message("name = ").starts_with("n.toml: "));
    }
}
