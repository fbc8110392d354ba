//! By which ways can an adapter be asked, and in which steps does each do it?

/// How an adapter is asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum GpuQueryKind {
    /// Boxes in colours, and the image read back; again without those that appeared.
    ItemBuffer,
    /// The same, with colours counted by a compute shader.
    Histogram,
    /// The hardware's occlusion queries, up to 4,096 in a pass.
    OcclusionQueries,
    /// The same, one box at a time, each answer waited for.
    OneAtATime,
    /// Fragments that pass counted by the fragment shader: the extension that the paper proposed.
    PerFragment,
    /// Rectangles against a pyramid of farthest depths.
    ZPyramid,
    /// Boxes in colours, and tiles of 64 pixels read back where the pass before showed something; none where a whole front showed nothing.
    ItemBufferTiled,
}

impl GpuQueryKind {
    /// All of them.
    pub const ALL: [GpuQueryKind; 7] = [
        GpuQueryKind::ItemBuffer,
        GpuQueryKind::Histogram,
        GpuQueryKind::OcclusionQueries,
        GpuQueryKind::OneAtATime,
        GpuQueryKind::PerFragment,
        GpuQueryKind::ZPyramid,
        GpuQueryKind::ItemBufferTiled,
    ];

    /// Its name in reports and on command lines.
    pub const fn name(self) -> &'static str {
        match self {
            GpuQueryKind::ItemBuffer => "gpu-item-buffer",
            GpuQueryKind::Histogram => "gpu-histogram",
            GpuQueryKind::OcclusionQueries => "gpu-occlusion-queries",
            GpuQueryKind::OneAtATime => "gpu-one-at-a-time",
            GpuQueryKind::PerFragment => "gpu-per-fragment",
            GpuQueryKind::ZPyramid => "gpu-z-pyramid",
            GpuQueryKind::ItemBufferTiled => "gpu-item-buffer-tiled",
        }
    }

    /// The kind of that name.
    pub fn from_name(name: &str) -> Option<GpuQueryKind> {
        GpuQueryKind::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// Whether a pass shows only what no other box of it hides, so that it is repeated.
    pub(super) const fn repeats(self) -> bool {
        matches!(self, GpuQueryKind::ItemBuffer | GpuQueryKind::ItemBufferTiled | GpuQueryKind::Histogram)
    }
}

impl std::fmt::Display for GpuQueryKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// A part of a query, where each is waited for before the next: what cPLP's Table 2 tells apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GpuStep {
    /// Boxes were drawn, or tested by a shader.
    Draw,
    /// What says the answers came to the host's memory; colours were counted before that, where a shader counts them.
    Transfer,
    /// The host looked through it.
    Scan,
}
