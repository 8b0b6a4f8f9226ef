//! Every setting of the motion initialisation.

use crate::AlignmentConfig;
use ffgs_fusion::{FusionConfig, GrowthConfig, Slack};
use ffgs_triangulation::TriangulationConfig;
use ffgs_voronoi::{AgreementConfig, SourceFilter, VoronoiConfig};
use serde::{Deserialize, Serialize};

/// Settings of every stage from tracks to the places at t.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MotionConfig {
    /// Which Gaussians stay valid.
    pub marking: MarkingConfig,
    /// Densification of tracks (Algorithm 2).
    pub voronoi: VoronoiConfig,
    /// Cross-level agreement.
    pub agreement: AgreementConfig,
    /// Gaussians to pixels.
    pub association: AssociationConfig,
    /// Rays to positions.
    pub triangulation: TriangulationConfig,
    /// Positions to a posterior.
    pub fusion: FusionConfig,
    /// Rigid groups aligned with the photographs.
    pub alignment: AlignmentConfig,
    /// Growth by uncertainty.
    pub densification: GrowthConfig,
}

impl MotionConfig {
    /// Our most literal reading of the paper's motion initialisation (Algorithms 1 and 2).
    pub fn literal() -> Self {
        let defaults = Self::default();
        Self {
            marking: MarkingConfig::literal(),
            voronoi: VoronoiConfig {
                source_filter: SourceFilter::All,
                use_visibility: false,
                ..defaults.voronoi
            },
            agreement: AgreementConfig { magnitude_floor_px: 0.0, ignore_unknown: false },
            association: AssociationConfig {
                flow_floor_px: 0.0,
                min_transmittance: 1e-4,
                contributors: 16,
                withdraw_unseen: false,
                rotate: Rotate::Nothing,
                ..defaults.association
            },
            triangulation: TriangulationConfig::literal(),
            fusion: FusionConfig::literal(),
            alignment: AlignmentConfig { steps: 0, ..defaults.alignment },
            ..defaults
        }
    }
}

/// A Gaussian is dynamic (valid) when inside the mask in all views that see it but for the slack.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MarkingConfig {
    /// Pixels by which the masks are widened before marking and validation ([`ffgs_core::Mask::widened`]).
    pub dilation: usize,
    /// Views that may disagree, however many see it (Algorithm 1: 2).
    pub slack: u32,
    /// And share of the views that see it.
    pub slack_share: f64,
    /// In place of that share where a frame after the first removes moving Gaussians that its masks lack (docs/adr/0096).
    pub validation_share: f64,
    /// Whether views that do not see a Gaussian disagree.
    pub all_views: bool,
    /// Whether Gaussians outside the masks of t are placed once more by their neighbours' motion, many that are lost at once wait for the next frame,
    /// and masks that flicker have no say.
    pub second_chance: bool,
    /// Share of what a Gaussian colours in the views of the first frame that has to lie in the masks; 0 = where it lies alone counts.
    pub shown_share: f32,
    /// Whether both layers are marked again at t-1 in every frame.
    pub every_frame: bool,
    /// Alpha of the moving layer from which it covers what is behind it; static Gaussians that are covered in all views, or stand before it in
    /// one, are left out of the frame. 0 = none is.
    pub covering_alpha: f32,
    /// Share of an object of the dynamic layer that one frame's masks lack, beyond which the run warns and waits for the next.
    pub loss_warning: f64,
}

impl Default for MarkingConfig {
    fn default() -> Self {
        Self {
            dilation: 2,
            slack: 0,
            slack_share: 0.2,
            validation_share: 0.5,
            all_views: false,
            second_chance: true,
            shown_share: 0.25,
            every_frame: false,
            covering_alpha: 0.5,
            loss_warning: 0.2,
        }
    }
}

impl MarkingConfig {
    /// Our most literal reading of Algorithm 1, lines 2 and 35 to 40.
    pub fn literal() -> Self {
        Self {
            dilation: 0,
            slack: 2,
            slack_share: 0.0,
            validation_share: 0.0,
            second_chance: false,
            shown_share: 0.0,
            every_frame: true,
            covering_alpha: 0.0,
            ..Self::default()
        }
    }

    /// Whether both mark the same Gaussians in the first frame.
    pub fn marks_as(&self, other: &Self) -> bool {
        (self.dilation, self.slack(), self.shown_share) == (other.dilation, other.slack(), other.shown_share)
    }

    /// The views that may disagree with a Gaussian that is to be dynamic.
    pub fn slack(&self) -> Slack {
        Slack { views: self.slack, share: self.slack_share, all_views: self.all_views }
    }

    /// The views that may disagree with one that is, before it is removed.
    pub fn validation_slack(&self) -> Slack {
        Slack { share: self.validation_share, ..self.slack() }
    }
}

/// Sums over the pixels a Gaussian covers (Algorithm 1, lines 15 to 19).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AssociationConfig {
    /// Least motion in the weight (px); 0 = literal, and standing parts are never measured.
    pub flow_floor_px: f32,
    /// Least sum of blending weights.
    pub min_coverage: f32,
    /// Least number of pixels.
    pub min_hits: u32,
    /// A pixel is finished before the contribution that would bring its transmittance to this value: what shows
    /// through less moves with what hides it. 1e-4 = as far as is rendered.
    pub min_transmittance: f32,
    /// Gaussians that each pixel counts for, the heaviest, at most 64, as each takes memory and time per pixel; 0 = all.
    pub contributors: usize,
    /// Whether the flow under a footprint is its mean, weighted by the blending weights; else the sum.
    pub normalise: bool,
    /// Whether what cannot be in a view's image at t is left unobserved there.
    pub withdraw_unseen: bool,
    /// What turns with the rigid motion.
    pub rotate: Rotate,
}

/// What turns with the rigid motion of a Gaussian's group at initialisation; the paper moves positions only.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rotate {
    /// Nothing (literal).
    Nothing,
    /// The splat.
    Splat,
    /// The splat and the directions of its colour.
    #[default]
    SplatAndColour,
}

impl Default for AssociationConfig {
    fn default() -> Self {
        Self {
            flow_floor_px: 0.25,
            min_coverage: 1e-3,
            min_hits: 2,
            min_transmittance: 1e-2,
            contributors: 0,
            normalise: true,
            withdraw_unseen: true,
            rotate: Rotate::default(),
        }
    }
}
