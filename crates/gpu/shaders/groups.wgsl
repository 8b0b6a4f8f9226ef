// Dispatches are split over two dimensions, because one holds at most 65535 groups.

fn linear_group(group: vec3u, groups: vec3u) -> u32 {
    return group.y * groups.x + group.x;
}
