//! Rounding that several formats share.

/// `value` (0..=1) as an unsigned integer of `bits` bits.
pub(crate) fn unorm(value: f32, bits: u32) -> u32 {
    let top = ((1_u32 << bits) - 1) as f32;
    (value * top).round().clamp(0.0, top) as u32
}

/// `value` rounded to the nearest byte.
pub(crate) fn to_byte(value: f32) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}

/// A unit quaternion by its three smaller components: the index of the largest, which is made positive, and the others
/// in their order, each between -sqrt(1/2) and sqrt(1/2). A quaternion of length 0 becomes the identity (1, 0, 0, 0).
pub(crate) fn smallest_three(quat: [f32; 4]) -> (usize, [f32; 3]) {
    let length = quat.iter().map(|v| v * v).sum::<f32>().sqrt();
    let unit = if length > 0.0 { quat.map(|v| v / length) } else { [1.0, 0.0, 0.0, 0.0] };
    let mut largest = 0;
    for i in 1..4 {
        if unit[i].abs() > unit[largest].abs() {
            largest = i;
        }
    }
    let sign = if unit[largest] < 0.0 { -1.0 } else { 1.0 };
    let mut rest = [0.0; 3];
    let others = (0..4).filter(|&i| i != largest);
    rest.iter_mut().zip(others).for_each(|(out, i)| *out = sign * unit[i]);
    (largest, rest)
}

/// Inverse of [`smallest_three`].
pub(crate) fn from_smallest_three(largest: usize, rest: [f32; 3]) -> [f32; 4] {
    let squares: f32 = rest.iter().map(|v| v * v).sum();
    let mut out = [0.0; 4];
    let mut rest = rest.into_iter();
    for (i, value) in out.iter_mut().enumerate() {
        *value = if i == largest { (1.0 - squares).max(0.0).sqrt() } else { rest.next().unwrap_or(0.0) };
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quaternion_and_its_negative_come_back_as_one_rotation() {
        let quat = [-0.1_f32, 0.5, -0.7, 0.5];
        let length = quat.iter().map(|v| v * v).sum::<f32>().sqrt();
        let (largest, rest) = smallest_three(quat);
        assert_eq!(largest, 2);
        let back = from_smallest_three(largest, rest);
        for (b, q) in back.iter().zip(quat) {
            assert!((b + q / length).abs() < 1e-6, "{back:?}");
        }
        assert_eq!(smallest_three([0.0; 4]), (0, [0.0; 3]));
    }

    #[test]
    fn rounding_saturates() {
        assert_eq!((unorm(-1.0, 11), unorm(2.0, 11), unorm(0.5, 8)), (0, 2047, 128));
        assert_eq!((to_byte(-3.0), to_byte(300.0), to_byte(7.5)), (0, 255, 8));
    }
}
