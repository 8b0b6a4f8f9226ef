/// Stable LSD radix sort of `(key, value)` pairs by key, 11 bits a pass; `scratch` is resized and reused.
pub(crate) fn radix_sort(pairs: &mut Vec<(u32, u32)>, scratch: &mut Vec<(u32, u32)>) {
    const BITS: u32 = 11;
    const BUCKETS: usize = 1 << BITS;
    scratch.clear();
    scratch.resize(pairs.len(), (0, 0));
    for pass in 0..3 {
        let digit = |key: u32| (key >> (pass * BITS)) as usize & (BUCKETS - 1);
        let mut starts = [0_u32; BUCKETS];
        pairs.iter().for_each(|&(key, _)| starts[digit(key)] += 1);
        let mut sum = 0;
        for start in &mut starts {
            sum += std::mem::replace(start, sum);
        }
        for &pair in pairs.iter() {
            let start = &mut starts[digit(pair.0)];
            scratch[*start as usize] = pair;
            *start += 1;
        }
        std::mem::swap(pairs, scratch);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_the_standard_stable_sort() {
        let mut pairs: Vec<(u32, u32)> =
            (0..5000_u32).map(|i| (i.wrapping_mul(2_654_435_761) >> (i % 23), i)).collect();
        let mut expected = pairs.clone();
        expected.sort_by_key(|p| p.0);
        radix_sort(&mut pairs, &mut Vec::new());
        assert_eq!(pairs, expected);
    }
}
