//! The arrays that a single stage reads, checked: every error names the file and the array.

use anyhow::{Context, Result, anyhow, bail, ensure};
use ffgs_arrays::{Array, Element, NpzFile};
use ffgs_core::{Camera, ImageSize, Intrinsics};
use glam::{DMat3, DMat4, DVec2, DVec3};
use std::path::Path;

/// Any length of an axis, in the shapes that [`Input`] asks for.
pub(super) const ANY: Option<usize> = None;

/// A stage's input file. Every error names the file and the array.
pub(super) struct Input(NpzFile);

impl Input {
    pub(crate) fn open(path: &Path) -> Result<Self> {
        Ok(Self(NpzFile::open(path)?))
    }

    /// An error about one array.
    pub(crate) fn fault(&self, key: &str, what: impl std::fmt::Display) -> anyhow::Error {
        anyhow!("{}, array '{key}': {what}", self.0.path().display())
    }

    /// An array of that shape; it may be empty.
    pub(crate) fn maybe_empty<T: Element>(&self, key: &str, shape: &[Option<usize>]) -> Result<Array<T>> {
        Ok(self.0.shaped(key, shape)?)
    }

    /// An array of that shape with at least one entry.
    pub(crate) fn array<T: Element>(&self, key: &str, shape: &[Option<usize>]) -> Result<Array<T>> {
        let array = self.maybe_empty(key, shape)?;
        ensure!(!array.data.is_empty(), self.fault(key, format!("empty, shape {:?}", array.shape)));
        Ok(array)
    }

    /// As [`Input::array`], every entry finite.
    pub(crate) fn finite<T: Element + Into<f64>>(
        &self,
        key: &str,
        shape: &[Option<usize>],
    ) -> Result<Array<T>> {
        let array = self.array(key, shape)?;
        self.check_finite(key, &array)?;
        Ok(array)
    }

    /// Refuses NaN and infinity.
    pub(crate) fn check_finite<T: Element + Into<f64>>(&self, key: &str, array: &Array<T>) -> Result<()> {
        match array.data.iter().position(|&v| !v.into().is_finite()) {
            Some(index) => Err(self.fault(key, format!("entry {index} is not finite"))),
            None => Ok(()),
        }
    }

    /// A single finite number.
    pub(crate) fn number(&self, key: &str) -> Result<f64> {
        let value = self.0.f64(key)?.scalar()?;
        ensure!(value.is_finite(), self.fault(key, "not finite"));
        Ok(value)
    }

    /// A single whole number that is not negative.
    pub(crate) fn count(&self, key: &str) -> Result<usize> {
        let value = self.0.i64(key)?.scalar()?;
        usize::try_from(value).map_err(|_| self.fault(key, format!("{value} is negative")))
    }

    /// An image size; `key` names the array for messages.
    pub(crate) fn image_size(&self, key: &str, height: i64, width: i64) -> Result<ImageSize> {
        let pixels = usize::try_from(height).ok().zip(usize::try_from(width).ok());
        match pixels {
            Some((height, width)) if (1..=ImageSize::MAX_PIXELS).contains(&height.saturating_mul(width)) => {
                Ok(ImageSize { width, height })
            }
            _ => bail!(self.fault(key, format!("{width} x {height} pixels is not an image size"))),
        }
    }

    /// (V, 4) `intrinsics` and (V, 4, 4) `camera_from_world`.
    pub(crate) fn cameras(&self, size: ImageSize) -> Result<Vec<Camera>> {
        let intrinsics = self.array::<f64>("intrinsics", &[ANY, Some(4)])?;
        let views = intrinsics.shape[0];
        let poses = self.array::<f64>("camera_from_world", &[Some(views), Some(4), Some(4)])?;
        let entries = intrinsics.data.as_chunks::<4>().0.iter().zip(poses.data.as_chunks::<16>().0);
        let read = |(view, (k, pose)): (usize, (&[f64; 4], &[f64; 16]))| {
            camera(*k, pose, size).with_context(|| self.fault("camera_from_world", format!("view {view}")))
        };
        entries.enumerate().map(read).collect()
    }
}

/// A camera from (fx, fy, cx, cy) and a row-major pose.
pub(super) fn camera([fx, fy, cx, cy]: [f64; 4], pose: &[f64; 16], size: ImageSize) -> Result<Camera> {
    let pose = DMat4::from_cols_array(pose).transpose();
    Ok(Camera::new(Intrinsics { fx, fy, cx, cy }, pose, size)?)
}

/// (N, 2) rows.
pub(super) fn points2(values: &[f64]) -> Vec<DVec2> {
    values.as_chunks::<2>().0.iter().map(|&p| DVec2::from(p)).collect()
}

/// (N, 3) rows.
pub(super) fn points3(values: &[f64]) -> Vec<DVec3> {
    values.as_chunks::<3>().0.iter().map(|&p| DVec3::from(p)).collect()
}

/// (N, 3, 3) row-major matrices.
pub(super) fn matrices3(values: &[f64]) -> Vec<DMat3> {
    values.as_chunks::<9>().0.iter().map(|m| DMat3::from_cols_array(m).transpose()).collect()
}

/// Points as (N, 3) rows.
pub(super) fn flat_points3(points: &[DVec3]) -> Vec<f64> {
    points.iter().flat_map(DVec3::to_array).collect()
}

/// Matrices as (N, 3, 3) in row-major order.
pub(super) fn flat_matrices3(matrices: &[DMat3]) -> Vec<f64> {
    matrices.iter().flat_map(|m| m.transpose().to_cols_array()).collect()
}

/// f64 values as f32.
pub(super) fn narrow(values: &[f64]) -> Vec<f32> {
    values.iter().map(|&v| v as f32).collect()
}
