//! The settings of the reconstruction; those of the motion initialisation are the method's own.

use ffgs_fusion::{GroupsConfig, GrowthConfig};
use ffgs_motion::MarkingConfig;
use ffgs_trainer::{
    BackgroundConfig, BirthConfig, DisocclusionConfig, DynamicLaneConfig, FirstFrameConfig, ResolutionConfig,
};

/// How the frames of a capture are reconstructed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReconstructionConfig {
    /// Seed of everything random.
    pub seed: u64,
    /// Edge of a sky cube face (px).
    pub sky_face_size: usize,
    /// Frame 0.
    pub first_frame: FirstFrameConfig,
    /// Which Gaussians are dynamic.
    pub marking: MarkingConfig,
    /// Which moving Gaussians lie together.
    pub groups: GroupsConfig,
    /// Bounds of the dynamic layer's growth.
    pub densification: GrowthConfig,
    /// Moving Gaussians where masks are not explained.
    pub birth: BirthConfig,
    /// How large photographs are in the frames after the first.
    pub resolution: ResolutionConfig,
    /// Finetuning of the dynamic layer.
    pub dynamic: DynamicLaneConfig,
    /// Finetuning of the static layer and the sky.
    pub background: BackgroundConfig,
    /// Training of static Gaussians that come to light.
    pub disocclusion: DisocclusionConfig,
}

impl Default for ReconstructionConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            sky_face_size: 128,
            first_frame: FirstFrameConfig::default(),
            marking: MarkingConfig::default(),
            groups: GroupsConfig::default(),
            densification: GrowthConfig::default(),
            birth: BirthConfig::default(),
            resolution: ResolutionConfig::default(),
            dynamic: DynamicLaneConfig::default(),
            background: BackgroundConfig::default(),
            disocclusion: DisocclusionConfig::default(),
        }
    }
}
