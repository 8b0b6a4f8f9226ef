use glam::{DMat3, DVec3};

/// A symmetric 3x3 normal system `A x = b`.
#[derive(Clone, Copy, Debug, Default)]
pub struct Normal {
    pub a: DMat3Zero,
    pub b: DVec3,
}

/// A [`DMat3`] whose default is zero, not the identity.
#[derive(Clone, Copy, Debug)]
pub struct DMat3Zero(pub DMat3);

impl Default for DMat3Zero {
    fn default() -> Self {
        Self(DMat3::ZERO)
    }
}

impl Normal {
    pub fn add(&mut self, a: DMat3, b: DVec3) {
        self.a.0 += a;
        self.b += b;
    }

    pub fn solve(&self) -> Option<DVec3> {
        inverse(&self.a.0).map(|inverse| inverse * self.b)
    }
}

/// `v v^T`.
pub fn outer(v: DVec3) -> DMat3 {
    DMat3::from_cols(v * v.x, v * v.y, v * v.z)
}

/// Pivots below this fraction of the diagonal are rounding, not information.
const PIVOT: f64 = 1e-13;

/// Inverse of a symmetric positive definite matrix by Cholesky; `None` when it is not, to working precision.
pub fn inverse(m: &DMat3) -> Option<DMat3> {
    // Scaled to a unit diagonal: units and weights do not decide what counts as singular.
    let d = DVec3::new(m.x_axis.x, m.y_axis.y, m.z_axis.z);
    if !(d.min_element() > 0.0 && d.is_finite()) {
        return None;
    }
    let s = DVec3::new(d.x.sqrt(), d.y.sqrt(), d.z.sqrt()).recip();
    let (l10, l20) = (m.x_axis.y * s.x * s.y, m.x_axis.z * s.x * s.z);
    let p1 = 1.0 - l10 * l10;
    if !(p1 > PIVOT) {
        return None;
    }
    let l11 = p1.sqrt();
    let l21 = (m.y_axis.z * s.y * s.z - l20 * l10) / l11;
    let p2 = 1.0 - l20 * l20 - l21 * l21;
    if !(p2 > PIVOT) {
        return None;
    }
    let l22 = p2.sqrt();
    // Rows of L^-1, then A^-1 = L^-T L^-1, unscaled.
    let r1 = DVec3::new(-l10 / l11, 1.0 / l11, 0.0);
    let r2 = DVec3::new(-(l20 + l21 * r1.x) / l22, -l21 * r1.y / l22, 1.0 / l22);
    let inverse = outer(DVec3::X) + outer(r1) + outer(r2);
    Some(DMat3::from_cols(inverse.x_axis * s * s.x, inverse.y_axis * s * s.y, inverse.z_axis * s * s.z))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverse_is_an_inverse_or_refused() {
        let vectors = [DVec3::new(1.0, 2.0, -0.5), DVec3::new(0.1, -1.0, 0.3), DVec3::new(4.0, 0.2, 0.7)];
        let m: DMat3 = vectors.iter().fold(DMat3::ZERO, |m, &v| m + outer(v));
        let error = m * inverse(&m).unwrap() - DMat3::IDENTITY;
        assert!(error.to_cols_array().iter().all(|v| v.abs() < 1e-12));
        assert!(inverse(&(outer(vectors[0]) + outer(vectors[1]))).is_none());
        assert!(inverse(&DMat3::from_diagonal(DVec3::NAN)).is_none());
    }
}
