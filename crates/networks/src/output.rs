//! What networks give, in pixels of the photograph.

use crate::description::Center;
use crate::picture::Fit;
use crate::{FlowOutput, Layout, MatchOutput};
use ffgs_core::TrackSet;

/// Values of an output with its shape.
#[derive(Clone, Debug)]
pub(crate) struct Tensor<T> {
    pub shape: Vec<usize>,
    pub data: Vec<T>,
}

impl<T: Copy> Tensor<T> {
    /// The rows of a list of tuples: dimensions of length 1 in front are left out.
    fn rows<const N: usize>(&self) -> Option<Vec<[T; N]>> {
        let rank = self.shape.len();
        let is_list =
            rank >= 2 && self.shape[rank - 1] == N && self.shape[..rank - 2].iter().all(|n| *n == 1);
        is_list.then(|| self.data.as_chunks::<N>().0.to_vec())
    }

    /// The values of a list; dimensions of length 1 are left out.
    fn list(&self) -> Option<&[T]> {
        (self.shape.iter().filter(|n| **n != 1).count() <= 1).then_some(&self.data)
    }
}

/// Displacements for every pixel of the photograph. The error says what the output should have been.
pub(crate) fn flow(tensor: &Tensor<f32>, fit: &Fit, output: &FlowOutput) -> Result<Vec<[f32; 2]>, String> {
    let (width, height) = (fit.padded.width, fit.padded.height);
    let wanted = match output.layout {
        Layout::Nchw => [1, 2, height, width],
        Layout::Nhwc => [1, height, width, 2],
    };
    let shape: &[usize] = if tensor.shape.len() == 3 { &wanted[1..] } else { &wanted };
    if tensor.shape != shape {
        return Err(format!(
            "output '{}' has the shape {:?} instead of {wanted:?}",
            output.output, tensor.shape
        ));
    }
    let bad = tensor.data.iter().filter(|v| !v.is_finite()).count();
    if bad > 0 {
        let all = tensor.data.len();
        return Err(format!("{bad} of {all} values of output '{}' are NaN or infinite", output.output));
    }
    let plane = width * height;
    let at = |x: usize, y: usize| match output.layout {
        Layout::Nchw => [tensor.data[y * width + x], tensor.data[plane + y * width + x]],
        Layout::Nhwc => [tensor.data[2 * (y * width + x)], tensor.data[2 * (y * width + x) + 1]],
    };
    Ok(to_photograph(fit, at))
}

/// Samples the network's field at the photograph's pixel centres.
fn to_photograph(fit: &Fit, at: impl Fn(usize, usize) -> [f32; 2]) -> Vec<[f32; 2]> {
    let scale = fit.scale();
    let columns = Samples::new(fit.photograph.width, fit.content.width, scale[0]);
    let rows = Samples::new(fit.photograph.height, fit.content.height, scale[1]);
    let mix = |a: [f32; 2], b: [f32; 2], t: f32| [a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t];
    let mut out = Vec::with_capacity(fit.photograph.pixels());
    for &(y, below, v) in &rows.0 {
        for &(x, right, u) in &columns.0 {
            let mean = mix(mix(at(x, y), at(right, y), u), mix(at(x, below), at(right, below), u), v);
            out.push([mean[0] * scale[0], mean[1] * scale[1]]);
        }
    }
    out
}

/// Per pixel of the photograph the two neighbours in the network's picture and the second one's weight.
struct Samples(Vec<(usize, usize, f32)>);

impl Samples {
    fn new(photograph: usize, content: usize, scale: f32) -> Self {
        let last = content - 1;
        let sample = |i: usize| {
            let position = ((i as f32 + 0.5) / scale - 0.5).clamp(0.0, last as f32);
            let first = position as usize;
            (first, (first + 1).min(last), position - first as f32)
        };
        Self((0..photograph).map(sample).collect())
    }
}

/// The outputs of a matcher.
pub(crate) struct Matches {
    pub first: Tensor<f32>,
    pub second: Tensor<f32>,
    pub indices: Option<Tensor<i64>>,
    pub scores: Option<Tensor<f32>>,
}

/// Pairs inside the photograph with a sufficient score. The error says what the outputs should have been.
pub(crate) fn tracks(found: &Matches, fit: &Fit, output: &MatchOutput) -> Result<TrackSet, String> {
    let positions = |tensor: &Tensor<f32>, name: &str| {
        let rows = tensor.rows::<2>();
        rows.ok_or_else(|| format!("output '{name}' has the shape {:?} instead of (N, 2)", tensor.shape))
    };
    let (first, second) =
        (positions(&found.first, &output.first)?, positions(&found.second, &output.second)?);
    let pairs = pairs(found, first.len(), second.len(), output)?;
    let scores = scores(found, first.len(), pairs.len(), output)?;
    let centre = if output.pixel_center == Center::Integer { 0.5 } else { 0.0 };
    let scale = fit.scale();
    let place = |p: [f32; 2]| [(p[0] + centre) * scale[0], (p[1] + centre) * scale[1]];
    let (width, height) = (fit.photograph.width as f32, fit.photograph.height as f32);
    let is_inside = |p: [f32; 2]| (0.0..=width).contains(&p[0]) && (0.0..=height).contains(&p[1]);
    let mut out = TrackSet::default();
    for (row, (i, j)) in pairs.into_iter().enumerate() {
        let (src, tgt) = (place(first[i]), place(second[j]));
        if src.iter().chain(&tgt).any(|v| !v.is_finite()) {
            return Err(format!("outputs '{}' and '{}' hold NaN or infinities", output.first, output.second));
        }
        let score = scores.as_ref().map(|s| s[if s.len() == first.len() { i } else { row }]);
        if score.is_none_or(|s| s >= output.least_score) && is_inside(src) && is_inside(tgt) {
            out.src.push(src);
            out.tgt.push(tgt);
            out.visibility.push(1.0);
        }
    }
    Ok(out)
}

fn scores<'a>(
    found: &'a Matches,
    positions: usize,
    pairs: usize,
    output: &MatchOutput,
) -> Result<Option<&'a [f32]>, String> {
    let (Some(tensor), Some(name)) = (&found.scores, &output.scores) else { return Ok(None) };
    let list = tensor.list().filter(|s| s.len() == positions || s.len() == pairs);
    let told =
        || format!("output '{name}' has the shape {:?}: not a score per pair or position", tensor.shape);
    list.map(Some).ok_or_else(told)
}

/// Which rows of the two lists of positions belong together.
fn pairs(
    found: &Matches,
    first: usize,
    second: usize,
    output: &MatchOutput,
) -> Result<Vec<(usize, usize)>, String> {
    let (Some(tensor), Some(name)) = (&found.indices, &output.indices) else {
        let told = || {
            format!(
                "outputs '{}' and '{}' have {first} and {second} rows, and no indices are named",
                output.first, output.second
            )
        };
        return if first == second { Ok((0..first).map(|i| (i, i)).collect()) } else { Err(told()) };
    };
    // A list of one index per position may have as many dimensions as one of pairs.
    let of_each = tensor.list().filter(|list| list.len() == first);
    let listed: Vec<[i64; 2]> = if let Some(list) = of_each {
        list.iter().enumerate().filter(|(_, j)| **j >= 0).map(|(i, j)| [i as i64, *j]).collect()
    } else if let Some(rows) = tensor.rows::<2>() {
        rows
    } else if let Some(rows) = tensor.rows::<3>() {
        rows.into_iter().map(|[_, i, j]| [i, j]).collect()
    } else {
        return Err(format!(
            "output '{name}' has the shape {:?} instead of ({first}), (K, 2) or (K, 3)",
            tensor.shape
        ));
    };
    let index = |value: i64, below: usize| usize::try_from(value).ok().filter(|v| *v < below);
    let pair = |[i, j]: [i64; 2]| {
        let both = index(i, first).zip(index(j, second));
        both.ok_or_else(|| {
            format!("output '{name}' pairs position {i} with {j}; there are {first} and {second}")
        })
    };
    listed.into_iter().map(pair).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::ImageSize;

    fn fit() -> Fit {
        Fit::new(ImageSize { width: 8, height: 4 }, Some(ImageSize { width: 4, height: 4 }), 1)
    }

    fn tensor<T>(shape: &[usize], data: Vec<T>) -> Tensor<T> {
        Tensor { shape: shape.to_vec(), data }
    }

    #[test]
    fn flow_is_brought_to_the_size_of_the_photograph() {
        // A ramp in u, so that samples between pixels can be told from the nearest; v is constant.
        let u = (0..16).map(|i| (i % 4) as f32);
        let data: Vec<f32> = u.chain(std::iter::repeat_n(3.0, 16)).collect();
        let output = FlowOutput { output: "f".into(), layout: Layout::Nchw };
        let found = flow(&tensor(&[1, 2, 4, 4], data.clone()), &fit(), &output).unwrap();
        // The photograph is twice as wide: displacements double, and pixel 3 lies at 1.25 of the network's.
        assert_eq!((found.len(), found[3], found[0]), (32, [2.5, 3.0], [0.0, 3.0]));
        let transposed: Vec<f32> = (0..16).flat_map(|i| [data[i], data[16 + i]]).collect();
        let nhwc = FlowOutput { layout: Layout::Nhwc, ..output };
        assert_eq!(flow(&tensor(&[1, 4, 4, 2], transposed), &fit(), &nhwc).unwrap(), found);
    }

    #[test]
    fn flow_of_another_shape_or_with_nan_is_refused() {
        let output = FlowOutput { output: "f".into(), layout: Layout::Nchw };
        let told = |t: &Tensor<f32>| flow(t, &fit(), &output).unwrap_err();
        assert!(told(&tensor(&[1, 2, 2, 2], vec![0.0; 8])).contains("[1, 2, 2, 2] instead of [1, 2, 4, 4]"));
        let mut data = vec![0.0; 32];
        data[7] = f32::NAN;
        assert!(told(&tensor(&[1, 2, 4, 4], data)).contains("1 of 32 values of output 'f'"));
    }

    fn output() -> MatchOutput {
        let text = "first = 'a'\nsecond = 'b'\nindices = 'i'\nscores = 's'\nleast_score = 0.5";
        toml::from_str(text).unwrap()
    }

    fn matched(indices: Option<Tensor<i64>>, scores: Vec<f32>) -> Matches {
        Matches {
            first: tensor(&[1, 3, 2], vec![0.0, 0.0, 1.0, 1.0, 3.0, 2.0]),
            second: tensor(&[2, 2], vec![2.0, 2.0, 3.0, 3.0]),
            indices,
            scores: Some(tensor(&[1, scores.len()], scores)),
        }
    }

    #[test]
    fn the_three_ways_to_list_pairs_mean_the_same() {
        let of_each = matched(Some(tensor(&[1, 3], vec![1, -1, 0])), vec![0.9, 0.9, 0.6]);
        let pairs = matched(Some(tensor(&[2, 2], vec![0, 1, 2, 0])), vec![0.9, 0.6]);
        let batched = matched(Some(tensor(&[2, 3], vec![0, 0, 1, 0, 2, 0])), vec![0.9, 0.6]);
        for case in [of_each, pairs, batched] {
            let found = tracks(&case, &fit(), &output()).unwrap();
            // Integer centres become half ones, then columns double.
            assert_eq!(found.src, [[1.0, 0.5], [7.0, 2.5]]);
            assert_eq!(found.tgt, [[7.0, 3.5], [5.0, 2.5]]);
        }
    }

    #[test]
    fn low_scores_and_what_lies_outside_are_left_out() {
        let mut case = matched(Some(tensor(&[3], vec![1, 1, 0])), vec![0.9, 0.4, 0.9]);
        case.second.data[0] = 40.0;
        assert_eq!(tracks(&case, &fit(), &output()).unwrap().src, [[1.0, 0.5]]);
    }

    #[test]
    fn impossible_pairs_are_refused() {
        let told = |case: &Matches| tracks(case, &fit(), &output()).unwrap_err();
        let beyond = matched(Some(tensor(&[1, 2], vec![0, 2])), vec![0.9]);
        assert!(told(&beyond).contains("position 0 with 2"));
        assert!(told(&matched(Some(tensor(&[4, 1, 2], vec![0; 8])), vec![0.9; 3])).contains("[4, 1, 2]"));
        assert!(told(&matched(Some(tensor(&[3], vec![0; 3])), vec![0.9; 7])).contains("'s'"));
        assert!(told(&matched(None, vec![0.9; 3])).contains("3 and 2 rows"));
        let mut nan = matched(Some(tensor(&[3], vec![0; 3])), vec![0.9; 3]);
        nan.first.data[0] = f32::NAN;
        assert!(told(&nan).contains("NaN"));
    }
}
