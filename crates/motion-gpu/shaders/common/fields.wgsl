// Motion fields of the trackers of one view over its masked pixels. Host side: `FieldsUniform` in motion-gpu.

struct Fields {
    // Masked pixels, and pixels of the image.
    pixels: u32,
    plane: u32,
    trackers: u32,
    // 1: trackers that know nothing at a pixel are left out of the agreement.
    ignore_unknown: u32,
    // Least mean flow that disagreement is divided by, and least flow in the weight (px).
    magnitude_floor: f32,
    flow_floor: f32,
    padding: vec2u,
}

// Trackers of a view at most.
const MOST_TRACKERS: u32 = 8u;
