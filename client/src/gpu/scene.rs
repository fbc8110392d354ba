//! What does an adapter hold of a scene? Its corners, and what each triangle needs to be drawn.

use std::ops::Range;

use eyeline_visibility::{Scene, Sides};

use super::{Gpu, GpuError};

/// A scene's triangles on an adapter, shared by all that draw them. 36 bytes a triangle.
#[derive(Debug)]
pub struct GpuScene {
    pub(super) corners: wgpu::Buffer,
    kinds: Vec<Kind>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Kind {
    sides: Sides,
    occludes: bool,
}

/// Corners to draw, and which sides of them.
pub(super) type Run = (Sides, Range<u32>);

impl GpuScene {
    /// Takes a scene to an adapter.
    ///
    /// # Errors
    /// If the adapter takes no buffer of that size, or has no memory left.
    pub fn new(gpu: &Gpu, scene: &Scene) -> Result<GpuScene, GpuError> {
        let triangles = scene.triangles();
        let total = triangles.len() as u64;
        // Before anything is copied: three corners of three numbers each.
        gpu.check_buffer("triangles", wgpu::BufferUsages::VERTEX, 36 * total)?;
        if 3 * total > u64::from(u32::MAX) {
            return Err(GpuError::TooLarge {
                what: "a scene".into(),
                size: format!("{total} triangles"),
                adapter: gpu.name().to_owned(),
                limit: format!("{}", u32::MAX / 3),
                remedy: "take a smaller one",
            });
        }
        let numbers: Vec<f32> = triangles.iter().flat_map(|t| t.corners).flat_map(|corner| corner.to_array()).collect();
        let corners = gpu.buffer("triangles", wgpu::BufferUsages::VERTEX, bytemuck::cast_slice(&numbers))?;
        gpu.check()?;
        let kinds = triangles.iter().map(|t| Kind { sides: t.sides, occludes: t.occludes }).collect();
        Ok(GpuScene { corners, kinds })
    }

    /// Number of triangles.
    pub fn len(&self) -> usize {
        self.kinds.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.kinds.is_empty()
    }

    pub(super) fn occludes(&self, primitive: u32) -> bool {
        self.kinds[primitive as usize].occludes
    }

    /// The indices of the primitives' corners, and which of them can be drawn together, in the order given.
    pub(super) fn runs(&self, primitives: &[u32]) -> (Vec<u32>, Vec<Run>) {
        let mut runs: Vec<Run> = Vec::new();
        for (at, &id) in (0..).zip(primitives) {
            let sides = self.kinds[id as usize].sides;
            match runs.last_mut() {
                Some((last, range)) if *last == sides => range.end = 3 * at + 3,
                _ => runs.push((sides, 3 * at..3 * at + 3)),
            }
        }
        (primitives.iter().flat_map(|&id| 3 * id..3 * id + 3).collect(), runs)
    }
}
