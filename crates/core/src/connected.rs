//! Connected places of a grid.

/// The place `start` and all that are connected with it, each to one that it lies beside (4-neighbours) and that it `joins`. Marks them as
/// `seen`; places that were seen before do not belong to it.
pub fn connected(
    start: usize,
    columns: usize,
    seen: &mut [bool],
    joins: impl Fn(usize, usize) -> bool,
) -> Vec<usize> {
    let mut piece = vec![start];
    seen[start] = true;
    let mut next = 0;
    while let Some(&at) = piece.get(next) {
        next += 1;
        for other in beside(at, columns, seen.len()) {
            if !seen[other] && joins(at, other) {
                seen[other] = true;
                piece.push(other);
            }
        }
    }
    piece
}

/// The places left and right of one, above and below it.
fn beside(at: usize, columns: usize, places: usize) -> impl Iterator<Item = usize> {
    let column = at % columns;
    let left = (column > 0).then(|| at - 1);
    let right = (column + 1 < columns).then_some(at + 1);
    let below = Some(at + columns).filter(|&i| i < places);
    [left, right, at.checked_sub(columns), below].into_iter().flatten()
}
