//! A loaded network, and what it computes for two photographs: flow or matches in pixels of the photographs.

use crate::output::{Matches, Tensor, flow, tracks};
use crate::picture::{Fit, channels};
use crate::{Description, FlowOutput, Input, Join, Layout, MatchOutput, NetworkError, library};
use ffgs_core::{ImageRgb8, ImageSize, TrackSet, open_input};
use ort::session::{Session, SessionInputValue, SessionOutputs};
use ort::value::{Outlet, TensorElementType, ValueType};
use std::io::Read;
use std::path::Path;

/// What a network found between two pictures, in pixels of the photographs.
#[derive(Clone, Debug, PartialEq)]
pub enum Motion {
    /// A displacement for every pixel of the earlier picture, row-major.
    Flow(Vec<[f32; 2]>),
    /// Pairs of positions; the centre of the first pixel is (0.5, 0.5).
    Tracks(TrackSet),
}

/// A network that is ready to run.
#[derive(Debug)]
pub struct Network {
    description: Description,
    session: Session,
    /// The size that it was made for; `None` when it takes any.
    fixed: Option<ImageSize>,
    checksum: u32,
}

impl Network {
    /// Loads ONNX Runtime, if nothing did before, and the network; `threads` compute it.
    ///
    /// # Errors
    /// When the library or the network cannot be loaded, and when the network's inputs and outputs are not those of
    /// the description.
    pub fn load(description: Description, threads: usize) -> Result<Self, NetworkError> {
        let file = description.model.clone();
        let checksum = checksum(&description)?;
        let told = |e: &dyn std::fmt::Display| NetworkError::model(&file, e.to_string());
        let session = Session::builder(library::environment()?)
            .and_then(|builder| Ok(builder.with_intra_threads(threads)?.with_deterministic_compute(true)?))
            .and_then(|mut builder| builder.commit_from_file(&file))
            .map_err(|e| told(&e))?;
        check_names(&session, &description).map_err(|reason| told(&reason))?;
        let fixed = fixed_size(session.inputs(), &description.input).map_err(|reason| told(&reason))?;
        Ok(Self { description, session, fixed, checksum })
    }

    /// What describes it.
    pub fn description(&self) -> &Description {
        &self.description
    }

    /// Of its file and its description: tells whether stored results are its own.
    pub fn checksum(&self) -> u32 {
        self.checksum
    }

    /// The motion from one picture to the next, which has the same size.
    ///
    /// # Errors
    /// When the network fails on pictures of this size, or gives shapes or values that cannot be used.
    pub fn motion(&mut self, before: &ImageRgb8, now: &ImageRgb8) -> Result<Motion, NetworkError> {
        let Self { description, session, fixed, .. } = self;
        let file = &description.model;
        let told = |reason: String| NetworkError::output(file, reason);
        if before.size() != now.size() {
            return Err(told(format!(
                "two pictures of different sizes: {:?}, {:?}",
                before.size(),
                now.size()
            )));
        }
        let fit = Fit::new(before.size(), *fixed, description.input.multiple);
        let inputs = inputs(&description.input, &fit, [before, now]).map_err(|e| told(e.to_string()))?;
        let outputs = session.run(inputs).map_err(|e| told(e.to_string()))?;
        let motion = match (&description.flow, &description.matches) {
            (Some(output), _) => flow_of(&outputs, &fit, output),
            (None, Some(output)) => matches_of(&outputs, &fit, output),
            (None, None) => Err("its description has neither [flow] nor [matches]".to_owned()),
        };
        motion.map_err(told)
    }
}

fn flow_of(outputs: &SessionOutputs<'_>, fit: &Fit, output: &FlowOutput) -> Result<Motion, String> {
    flow(&reals(outputs, &output.output)?, fit, output).map(Motion::Flow)
}

fn matches_of(outputs: &SessionOutputs<'_>, fit: &Fit, output: &MatchOutput) -> Result<Motion, String> {
    let found = Matches {
        first: reals(outputs, &output.first)?,
        second: reals(outputs, &output.second)?,
        indices: output.indices.as_ref().map(|name| integers(outputs, name)).transpose()?,
        scores: output.scores.as_ref().map(|name| reals(outputs, name)).transpose()?,
    };
    tracks(&found, fit, output).map(Motion::Tracks)
}

/// An output of numbers; positions may be integers.
fn reals(outputs: &SessionOutputs<'_>, name: &str) -> Result<Tensor<f32>, String> {
    let value = outputs.get(name).ok_or_else(|| format!("it gave no output '{name}'"))?;
    if let Ok((shape, data)) = value.try_extract_tensor::<i64>() {
        return Ok(Tensor { shape: lengths(shape), data: data.iter().map(|v| *v as f32).collect() });
    }
    let extracted = value.try_extract_tensor::<f32>();
    let (shape, data) = extracted.map_err(|e| format!("output '{name}': {e}"))?;
    Ok(Tensor { shape: lengths(shape), data: data.to_vec() })
}

fn integers(outputs: &SessionOutputs<'_>, name: &str) -> Result<Tensor<i64>, String> {
    let value = outputs.get(name).ok_or_else(|| format!("it gave no output '{name}'"))?;
    if let Ok((shape, data)) = value.try_extract_tensor::<i32>() {
        return Ok(Tensor { shape: lengths(shape), data: data.iter().map(|v| i64::from(*v)).collect() });
    }
    let extracted = value.try_extract_tensor::<i64>();
    let (shape, data) = extracted.map_err(|e| format!("output '{name}': {e}"))?;
    Ok(Tensor { shape: lengths(shape), data: data.to_vec() })
}

fn lengths(shape: &[i64]) -> Vec<usize> {
    shape.iter().map(|n| usize::try_from(*n).unwrap_or(0)).collect()
}

fn inputs(
    input: &Input,
    fit: &Fit,
    pictures: [&ImageRgb8; 2],
) -> ort::Result<Vec<(String, SessionInputValue<'static>)>> {
    let [before, now] = pictures.map(|picture| fit.tensor(picture, input));
    let (pictures_each, tensors) = match &input.names[..] {
        [both] => (2, vec![(both, [before, now].concat())]),
        names => (1, names.iter().zip([before, now]).collect()),
    };
    let shape = shape(input, fit.padded, pictures_each);
    let value = |(name, data): (&String, Vec<f32>)| {
        let tensor = ort::value::Tensor::from_array((shape.to_vec(), data))?;
        Ok((name.clone(), tensor.into()))
    };
    tensors.into_iter().map(value).collect()
}

fn shape(input: &Input, size: ImageSize, pictures: usize) -> [i64; 4] {
    let (mut batch, mut channels) = (1, channels(input.colour));
    match input.join {
        Join::Batch => batch *= pictures,
        Join::Channels => channels *= pictures,
    }
    let [n, c, h, w] = [batch, channels, size.height, size.width].map(|v| v as i64);
    match input.layout {
        Layout::Nchw => [n, c, h, w],
        Layout::Nhwc => [n, h, w, c],
    }
}

/// What of the description the network lacks, or the network of the description.
fn check_names(session: &Session, description: &Description) -> Result<(), String> {
    let (inputs, outputs) = (session.inputs(), session.outputs());
    let named = &description.input.names;
    let missing = |wanted: &str, kind: &str, all: &[Outlet]| {
        format!("it has no {kind} '{wanted}'; it has {}", list(all))
    };
    if let Some(name) = named.iter().find(|name| !has(inputs, name)) {
        return Err(missing(name, "input", inputs));
    }
    if let Some(other) = inputs.iter().find(|i| !named.iter().any(|n| n == i.name())) {
        let known = named.join(", ");
        return Err(format!("it has an input '{}' besides {known}; export it without", other.name()));
    }
    if let Some(name) = output_names(description).into_iter().find(|name| !has(outputs, name)) {
        return Err(missing(name, "output", outputs));
    }
    let is_real =
        |outlet: &&Outlet| matches!(outlet.dtype(), ValueType::Tensor { ty: TensorElementType::Float32, .. });
    match inputs.iter().find(|i| !is_real(i)) {
        Some(other) => {
            Err(format!("input '{}' is {} instead of a tensor of f32", other.name(), other.dtype()))
        }
        None => Ok(()),
    }
}

fn output_names(description: &Description) -> Vec<&str> {
    let of_flow = description.flow.iter().map(|f| Some(&f.output));
    let of_matches = description
        .matches
        .iter()
        .flat_map(|m| [Some(&m.first), Some(&m.second), m.indices.as_ref(), m.scores.as_ref()]);
    of_flow.chain(of_matches).flatten().map(String::as_str).collect()
}

fn has(all: &[Outlet], name: &str) -> bool {
    all.iter().any(|outlet| outlet.name() == name)
}

fn list(all: &[Outlet]) -> String {
    all.iter().map(|o| format!("{} {}", o.name(), o.dtype())).collect::<Vec<_>>().join(", ")
}

/// The size of the pictures that a network was exported for, and whether its other dimensions are as described.
fn fixed_size(inputs: &[Outlet], input: &Input) -> Result<Option<ImageSize>, String> {
    let asked = input.size.map(|[width, height]| ImageSize { width, height });
    let pictures = if input.names.len() == 1 { 2 } else { 1 };
    // The sides do not matter here.
    let wanted = shape(input, ImageSize { width: 1, height: 1 }, pictures);
    let (channel, row) = if input.layout == Layout::Nchw { (1, 2) } else { (3, 1) };
    let Some(ValueType::Tensor { shape, .. }) = inputs.first().map(Outlet::dtype) else { return Ok(asked) };
    if shape.len() != 4 {
        return Err(format!("its input has {} dimensions instead of 4", shape.len()));
    }
    if let Some(at) = [0, channel].into_iter().find(|at| shape[*at] > 0 && shape[*at] != wanted[*at]) {
        return Err(format!(
            "its input has the shape {shape:?}, and the description asks for {} in dimension {at} \
            (layout, colour, join)",
            wanted[at]
        ));
    }
    let side = |at: usize| usize::try_from(shape[at]).ok().filter(|v| *v > 0);
    let own = match (side(row), side(row + 1)) {
        (Some(height), Some(width)) => Some(ImageSize { width, height }),
        (None, None) => None,
        _ => {
            return Err(format!(
                "its input has the shape {shape:?}: one side only is fixed (layout, colour, join)"
            ));
        }
    };
    match (own, asked) {
        (Some(own), Some(asked)) if own != asked => Err(format!(
            "it was exported for pictures of {} x {}; input.size asks for {} x {}",
            own.width, own.height, asked.width, asked.height
        )),
        (own, asked) => Ok(own.or(asked)),
    }
}

/// Also tells early, with the file's name, that there is none.
fn checksum(description: &Description) -> Result<u32, NetworkError> {
    let file: &Path = &description.model;
    let told = |e: std::io::Error| NetworkError::model(file, e.to_string());
    let mut hasher = crc32fast::Hasher::new();
    hasher
        .update(format!("{:?}{:?}{:?}", description.input, description.flow, description.matches).as_bytes());
    let mut reader = open_input(file).map_err(told)?;
    let mut block = vec![0; 1 << 20];
    loop {
        match reader.read(&mut block).map_err(told)? {
            0 => return Ok(hasher.finalize()),
            read => hasher.update(&block[..read]),
        }
    }
}
