// The parts of a tile's list that workgroups take side by side (docs/adr/0078-lists-in-parts-pixels-in-vectors.md). `blend` keeps what
// the pixels show where each begins, behind the entries of all pairs; `entries` is a binding of the entry file.

// Splats of each part of a list of `length`, in whole batches.
fn part_length(length: u32) -> u32 {
    return max((length + view.parts * BATCH - 1u) / (view.parts * BATCH), 1u) * BATCH;
}

// Behind the entries, what the pixels show where a part begins. First number of a channel of an invocation's column.
fn state_at(slot: u32, part: u32, channel: u32, place: vec2u) -> u32 {
    let tile = ((slot * view.parts + part) * 4u + channel) * AREA;
    return view.pair_capacity * ENTRY + tile + place.y * TILE + place.x;
}

// That channel of the column's four pixels.
fn state_of(slot: u32, part: u32, channel: u32, place: vec2u) -> vec4f {
    let at = state_at(slot, part, channel, place);
    return vec4f(entries[at], entries[at + TILE], entries[at + 2u * TILE], entries[at + 3u * TILE]);
}
