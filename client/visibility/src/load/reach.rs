//! How far does a moving thing ever get from its node's origin, in every pose of every animation and at every turn?
//!
//! A bound of something hidden must contain it whatever pose it will have by the time it is seen (S&G 1999, §3.3, articulated and
//! deformable objects), and no pose is known then. So each [`ObjectMesh`](crate::ObjectMesh) says a radius about its origin, which
//! every turn of the whole leaves as it is. It holds in the file's space, about where the origin rests in the file:
//!
//! - **Rigid nodes**: the farthest vertex.
//! - **Animated nodes**: what lies in a ball in a node's space lies in one in its parent's. An unanimated node moves the
//!   ball and scales it. One whose rotation or scale is animated may turn it anywhere about the node's own origin. An animated
//!   translation stays in the box of its keyframes; a cubic spline in that of its Bézier points, which overshoot. So animations
//!   may also be mixed: a mean of translations is in the same box.
//! - **Skins**: a vertex is a mean of where its joints take it, so it is no farther than the farthest of them: in each
//!   joint's space the ball around what the joint moves, taken up the joint's chain. By the specification (§3.7.3.3) the
//!   skinned node's own place does not matter. Joints need not be below the node that moves: they are taken to move with it.
//! - **Morph targets**: a vertex moves by at most the sum of the targets' displacements, each times its greatest weight: 1, or more
//!   where the file says more.

use std::collections::{BTreeMap, BTreeSet};

use glam::{DMat3, DMat4, DVec3};
use gltf::json::{
    accessor::Type,
    animation::{Interpolation, Property, Sampler},
    mesh,
    validation::Checked,
};

use super::{Instance, LoadError, Loader, Primitive, accessor::Elements};
use crate::Aabb;

/// How far something reaches.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Reach {
    /// Metres about its node's origin.
    pub(super) radius: f64,
    /// Whether it has poses other than the one that is loaded.
    pub(super) deforms: bool,
}

/// What animations do to a node.
struct Moves {
    /// Contains the translation.
    translation: Aabb,
    /// The part of its transform that turns and scales, if that is not animated.
    linear: Option<DMat3>,
    /// Greatest factor by which it scales.
    scale_max: f64,
}

/// The way from a node up to the root.
struct Chain {
    /// Takes a point of the node's space to that of the first ancestor that may turn it, or to the file's.
    upward: DMat4,
    /// What animated translations add there.
    slack: f64,
    /// The ancestor.
    turned_by: Option<usize>,
}

/// A ball.
#[derive(Clone, Copy)]
struct Ball {
    centre: DVec3,
    radius: f64,
}

/// Weights of a mesh's morph targets are at least this, since clients may set them.
const WEIGHT_MIN: f64 = 1.0;

/// What skinning in f32 may lose.
const ROUNDING: f64 = 1e-5;

/// Most vertices and keyframes looked at for each triangle allowed. A small file may claim very many.
const LOOKS_PER_TRIANGLE: u64 = 64;

/// Everything that poses depend on.
struct Poses<'l, 'a> {
    loader: &'l Loader<'a>,
    parents: Vec<Option<usize>>,
    moves: BTreeMap<usize, Moves>,
    /// Greatest animated weights of each node's morph targets.
    weights: BTreeMap<usize, Vec<f64>>,
    chains: BTreeMap<usize, Chain>,
    looks_left: u64,
}

impl Loader<'_> {
    /// The reach of each node that moves, by the node's index.
    pub(super) fn reaches(&self, instances: &[Instance]) -> Result<BTreeMap<usize, Reach>, LoadError> {
        let mut reaches: BTreeMap<usize, Reach> = BTreeMap::new();
        let movers: Vec<&Instance> = instances.iter().filter(|instance| instance.mover.is_some()).collect();
        if movers.is_empty() {
            return Ok(reaches);
        }
        let origins: BTreeMap<usize, DVec3> =
            movers.iter().map(|instance| (instance.node, instance.world_from_local.w_axis.truncate())).collect();
        let mut poses = Poses::new(self, &movers)?;
        for instance in movers {
            let Some(mover) = instance.mover else { continue };
            let reach = reaches.entry(mover).or_default();
            let found = poses.reach(instance, origins[&mover])?;
            reach.radius = farther(reach.radius, found.radius);
            reach.deforms |= found.deforms;
            if !reach.radius.is_finite() {
                return Err(self.node_error(mover, "has poses that reach infinitely far".into()));
            }
        }
        Ok(reaches)
    }
}

impl<'l, 'a> Poses<'l, 'a> {
    fn new(loader: &'l Loader<'a>, movers: &[&Instance]) -> Result<Poses<'l, 'a>, LoadError> {
        let root = loader.source.root;
        let mut parents = vec![None; root.nodes.len()];
        for (parent, node) in root.nodes.iter().enumerate() {
            for child in node.children.iter().flatten() {
                parents[child.value()] = Some(parent);
            }
        }
        let mut poses = Poses {
            loader,
            parents,
            moves: BTreeMap::new(),
            weights: BTreeMap::new(),
            chains: BTreeMap::new(),
            looks_left: u64::from(loader.options.triangles_max).max(1).saturating_mul(LOOKS_PER_TRIANGLE),
        };
        // Only what can move them: other animations may be as broken as they like.
        let mut concerned = BTreeSet::new();
        for instance in movers.iter().filter(|instance| instance.mesh.is_some()) {
            let joints = match poses.skin(instance)? {
                Some(skin) => root.skins[skin].joints.as_slice(),
                None => &[],
            };
            let nodes = std::iter::once(instance.node).chain(joints.iter().map(|joint| joint.value()));
            for start in nodes {
                let mut at = Some(start);
                while let Some(node) = at.filter(|&node| concerned.insert(node)) {
                    at = poses.parents[node];
                }
            }
        }
        for &node in &concerned {
            let local = loader.transform(node)?;
            let (linear, translation) = (DMat3::from_mat4(local), local.w_axis.truncate());
            let translation = Aabb::new(translation, translation);
            poses.moves.insert(node, Moves { translation, linear: Some(linear), scale_max: norm(linear) });
        }
        poses.read_animations(&concerned)?;
        Ok(poses)
    }

    /// The instance's skin, its joints checked.
    fn skin(&self, instance: &Instance) -> Result<Option<usize>, LoadError> {
        let root = self.loader.source.root;
        let Some(skin) = root.nodes[instance.node].skin.map(|skin| skin.value()) else { return Ok(None) };
        let from = format!("node {}", instance.node);
        let described =
            root.skins.get(skin).ok_or_else(|| self.loader.missing(&from, "skin", skin, root.skins.len()))?;
        let count = root.nodes.len();
        match described.joints.iter().find(|joint| joint.value() >= count) {
            Some(joint) => Err(self.loader.missing(&format!("skin {skin}"), "node", joint.value(), count)),
            None => Ok(Some(skin)),
        }
    }

    fn read_animations(&mut self, concerned: &BTreeSet<usize>) -> Result<(), LoadError> {
        let root = self.loader.source.root;
        for (index, animation) in root.animations.iter().enumerate() {
            let from = format!("animation {index}");
            for channel in &animation.channels {
                let node = channel.target.node.value();
                let Checked::Valid(path) = channel.target.path else { continue };
                if !concerned.contains(&node) {
                    continue;
                }
                let sampler = channel.sampler.value();
                let count = animation.samplers.len();
                let sampler = animation
                    .samplers
                    .get(sampler)
                    .ok_or_else(|| self.loader.missing(&from, "sampler", sampler, count))?;
                match path {
                    Property::Rotation => {}
                    Property::Translation | Property::Scale => {
                        let mut range = Aabb::EMPTY;
                        let mut add = |_: usize, point: [f64; 3]| range = range.with_point(DVec3::from_array(point));
                        self.read_values(sampler, Type::Vec3, &from, 1, &mut add)?;
                        let moves = self.moves.get_mut(&node).expect("concerned nodes have moves");
                        if range.is_empty() {
                            continue;
                        }
                        if matches!(path, Property::Translation) {
                            moves.translation = moves.translation.union(&range);
                        } else {
                            moves.scale_max = moves.scale_max.max(range.min.abs().max(range.max.abs()).max_element());
                        }
                    }
                    Property::MorphTargetWeights => {
                        let targets = self.targets(node);
                        let mut greatest = self.weights.remove(&node).unwrap_or_default();
                        greatest.resize(targets, 0.0);
                        if targets > 0 {
                            let mut add = |target: usize, [weight, ..]: [f64; 3]| {
                                greatest[target] = greatest[target].max(weight.abs());
                            };
                            self.read_values(sampler, Type::Scalar, &from, targets, &mut add)?;
                        }
                        self.weights.insert(node, greatest);
                    }
                }
                if matches!(path, Property::Rotation | Property::Scale) {
                    self.moves.get_mut(&node).expect("concerned nodes have moves").linear = None;
                }
            }
        }
        Ok(())
    }

    /// Most morph targets of a primitive of the node's mesh.
    fn targets(&self, node: usize) -> usize {
        let root = self.loader.source.root;
        let mesh = root.nodes[node].mesh.and_then(|mesh| root.meshes.get(mesh.value()));
        let targets =
            mesh.iter().flat_map(|mesh| &mesh.primitives).map(|primitive| primitive.targets.iter().flatten().count());
        targets.max().unwrap_or(0)
    }

    /// Calls `add` with points whose hull contains every value of a sampler. Keyframes hold `each` values; their index
    /// among these comes first.
    fn read_values(
        &mut self,
        sampler: &Sampler,
        shape: Type,
        from: &str,
        each: usize,
        add: &mut dyn FnMut(usize, [f64; 3]),
    ) -> Result<(), LoadError> {
        let source = &self.loader.source;
        let (input, output) = (sampler.input.value(), sampler.output.value());
        let values = source.numbers(output, from, shape)?;
        let width = if shape == Type::Vec3 { 3 } else { 1 };
        self.look(values.count as u64)?;
        let value = |i: usize| -> Result<[f64; 3], LoadError> {
            let value = std::array::from_fn(|axis| if axis < width { values.number(i, axis) } else { 0.0 });
            if value.iter().all(|value| value.is_finite()) {
                Ok(value)
            } else {
                Err(source.error(output, format!("keyframe value {i} is {value:?}, but must be finite")))
            }
        };
        if !matches!(sampler.interpolation, Checked::Valid(Interpolation::CubicSpline)) {
            for i in 0..values.count {
                add(i % each, value(i)?);
            }
            return Ok(());
        }
        let times = source.numbers(input, from, Type::Scalar)?;
        if times.count.checked_mul(3 * each) != Some(values.count) {
            let reason = format!(
                "{} values of {} keyframes of a cubic spline, which needs {each} × 3 each",
                values.count, times.count
            );
            return Err(source.error(output, reason));
        }
        // Of a spline from a to b in time t with tangents m and n, the Bézier points are a, a + m·t/3, b − n·t/3 and b.
        for key in 0..times.count {
            let at = |part: usize, i: usize| (3 * key + part) * each + i;
            let step = |a: usize, b: usize| -> Result<f64, LoadError> {
                let step = times.number(b, 0) - times.number(a, 0);
                if step.is_finite() && step >= 0.0 {
                    Ok(step / 3.0)
                } else {
                    Err(source.error(input, format!("keyframe {b} is not later than the one before")))
                }
            };
            let before = if key > 0 { step(key - 1, key)? } else { 0.0 };
            let after = if key + 1 < times.count { step(key, key + 1)? } else { 0.0 };
            for i in 0..each {
                let (coming, point, going) = (value(at(0, i))?, value(at(1, i))?, value(at(2, i))?);
                add(i, point);
                add(i, std::array::from_fn(|axis| point[axis] - coming[axis] * before));
                add(i, std::array::from_fn(|axis| point[axis] + going[axis] * after));
            }
        }
        Ok(())
    }

    /// How far the instance gets from `origin`.
    fn reach(&mut self, instance: &Instance, origin: DVec3) -> Result<Reach, LoadError> {
        let loader = self.loader;
        let mut reach = Reach::default();
        let Some(mesh) = instance.mesh else { return Ok(reach) };
        let primitives = &loader.meshes[&mesh].primitives;
        for primitive in primitives {
            let described = &loader.source.root.meshes[mesh].primitives[primitive.at];
            let morphs = self.morphs(instance.node, mesh, primitive, described)?;
            reach.deforms |= !morphs.is_empty();
            // As loaded, whatever skins do.
            let still = instance.world_from_local;
            self.look(3 * primitive.triangles as u64 * (1 + morphs.len() as u64))?;
            for vertex in primitive.corners().flatten() {
                let at = still.transform_point3(primitive.positions.position(vertex).into());
                reach.radius = farther(reach.radius, at.distance(origin));
            }
            let sets = loader.joint_sets(mesh, primitive, described)?;
            match self.skin(instance)? {
                Some(skin) if !sets.is_empty() => {
                    reach.deforms = true;
                    let found = self.skinned_reach(skin, mesh, primitive, &sets, &morphs, origin)?;
                    reach.radius = farther(reach.radius, found);
                }
                _ => {
                    let bound = self.rise(instance.node);
                    let (upward, slack, turned) = (bound.upward, bound.slack, bound.turned_by);
                    reach.deforms |= turned.is_some() || slack > 0.0;
                    let about = if turned.is_some() { DVec3::ZERO } else { origin };
                    let farthest = farthest(primitive, &morphs, upward, about) + slack;
                    reach.radius = farther(reach.radius, self.ascend(turned, farthest, origin));
                }
            }
        }
        Ok(reach)
    }

    /// How far the joints of a skin take a primitive's vertices.
    fn skinned_reach(
        &mut self,
        skin: usize,
        mesh: usize,
        primitive: &Primitive<'a>,
        sets: &[(Elements<'a>, Elements<'a>)],
        morphs: &[(f64, Elements<'a>)],
        origin: DVec3,
    ) -> Result<f64, LoadError> {
        let loader = self.loader;
        let root = loader.source.root;
        let joints: Vec<usize> = root.skins[skin].joints.iter().map(|joint| joint.value()).collect();
        self.look(joints.len() as u64)?;
        let binds = loader.inverse_binds(skin, joints.len())?;
        // Of each joint: from the skin's space to that in which its vertices are measured, and about which point.
        let mut measures = Vec::with_capacity(joints.len());
        for (&joint, bind) in joints.iter().zip(&binds) {
            let chain = self.rise(joint);
            let about = if chain.turned_by.is_some() { DVec3::ZERO } else { origin };
            let matrix = chain.upward * *bind;
            measures.push((matrix, norm(DMat3::from_mat4(matrix)), about, chain.slack, chain.turned_by));
        }
        let mut farthest: Vec<Option<f64>> = vec![None; joints.len()];
        self.look(3 * primitive.triangles as u64 * (4 * sets.len() + morphs.len()) as u64)?;
        let error = |reason: String| LoadError::Primitive {
            file: loader.source.file.into(),
            mesh,
            primitive: primitive.at,
            reason,
        };
        for vertex in primitive.corners().flatten() {
            let position = DVec3::from(primitive.positions.position(vertex));
            let morphed = displacement(morphs, vertex);
            let pairs = || {
                sets.iter().flat_map(|(joints, weights)| {
                    (0..4).map(|axis| (joints.whole(vertex, axis) as usize, weights.number(vertex, axis)))
                })
            };
            // Renderers differ about a vertex of no weight at all.
            let is_weightless = pairs().all(|(_, weight)| weight == 0.0);
            for (joint, weight) in pairs() {
                if !(weight.is_finite() && weight >= 0.0) {
                    return Err(error(format!("weight {weight} of vertex {vertex}; weights must be at least 0")));
                }
                if weight == 0.0 && !is_weightless {
                    continue;
                }
                let Some((matrix, scale, about, ..)) = measures.get(joint) else {
                    return Err(error(format!("joint {joint} of vertex {vertex}, but there are {}", joints.len())));
                };
                let distance = matrix.transform_point3(position).distance(*about) + scale * morphed;
                farthest[joint] = Some(farther(farthest[joint].unwrap_or(0.0), distance));
            }
        }
        let mut reach = 0.0f64;
        for (farthest, (.., slack, turned_by)) in farthest.iter().zip(&measures) {
            if let Some(farthest) = farthest {
                reach = farther(reach, self.ascend(*turned_by, farthest + slack, origin));
            }
        }
        Ok(reach)
    }

    /// Displacements of a primitive's morph targets, each with its greatest weight.
    fn morphs(
        &self,
        node: usize,
        mesh: usize,
        primitive: &Primitive<'a>,
        described: &mesh::Primitive,
    ) -> Result<Vec<(f64, Elements<'a>)>, LoadError> {
        let root = self.loader.source.root;
        let from = format!("mesh {mesh}, primitive {}", primitive.at);
        let own = root.nodes[node].weights.as_ref().or(root.meshes[mesh].weights.as_ref());
        let mut morphs = Vec::new();
        for (i, target) in described.targets.iter().flatten().enumerate() {
            let Some(positions) = target.positions else { continue };
            let displacements = self.loader.source.positions(positions.value(), &from)?;
            if displacements.count < primitive.positions.count {
                let reason = format!(
                    "{} displacements of {} vertices by a morph target",
                    displacements.count, primitive.positions.count
                );
                return Err(self.loader.source.error(positions.value(), reason));
            }
            let own = own.and_then(|own| own.get(i)).map_or(0.0, |&weight| f64::from(weight).abs());
            let animated = self.weights.get(&node).and_then(|weights| weights.get(i)).copied().unwrap_or(0.0);
            morphs.push((own.max(animated).max(WEIGHT_MIN), displacements));
        }
        Ok(morphs)
    }

    /// The way up from a node: as far as nothing turns, exactly.
    fn rise(&mut self, start: usize) -> &Chain {
        if !self.chains.contains_key(&start) {
            let mut chain = Chain { upward: DMat4::IDENTITY, slack: 0.0, turned_by: None };
            let mut at = Some(start);
            while let Some(node) = at {
                let moves = &self.moves[&node];
                let Some(linear) = moves.linear else {
                    chain.turned_by = Some(node);
                    break;
                };
                chain.upward = DMat4::from_mat3_translation(linear, moves.translation.centre()) * chain.upward;
                chain.slack = chain.slack * moves.scale_max + 0.5 * moves.translation.size().length();
                at = self.parents[node];
            }
            self.chains.insert(start, chain);
        }
        &self.chains[&start]
    }

    /// How far from `origin` something gets that is within `farthest` of the origin of the space of the node that turns
    /// it. If nothing does, `farthest` is about `origin` already.
    fn ascend(&self, turned_by: Option<usize>, farthest: f64, origin: DVec3) -> f64 {
        let Some(start) = turned_by else { return farthest * (1.0 + ROUNDING) };
        let mut ball = Ball { centre: DVec3::ZERO, radius: farthest };
        let mut at = Some(start);
        while let Some(node) = at {
            let moves = &self.moves[&node];
            let (middle, slack) = (moves.translation.centre(), 0.5 * moves.translation.size().length());
            ball = match moves.linear {
                Some(linear) => {
                    Ball { centre: middle + linear * ball.centre, radius: slack + moves.scale_max * ball.radius }
                }
                None => Ball { centre: middle, radius: slack + moves.scale_max * (ball.centre.length() + ball.radius) },
            };
            at = self.parents[node];
        }
        (ball.centre.distance(origin) + ball.radius) * (1.0 + ROUNDING)
    }

    /// Counts work, so that a small file can't ask for much of it.
    fn look(&mut self, times: u64) -> Result<(), LoadError> {
        match self.looks_left.checked_sub(times) {
            Some(left) => {
                self.looks_left = left;
                Ok(())
            }
            None => Err(LoadError::TooManyPoses {
                file: self.loader.source.file.into(),
                triangles_max: self.loader.options.triangles_max,
            }),
        }
    }
}

/// Greatest distance from `about` that a primitive's vertices have, morphed in any way.
fn farthest(primitive: &Primitive<'_>, morphs: &[(f64, Elements<'_>)], matrix: DMat4, about: DVec3) -> f64 {
    let scale = norm(DMat3::from_mat4(matrix));
    let distances = primitive.corners().flatten().map(|vertex| {
        let at = matrix.transform_point3(primitive.positions.position(vertex).into());
        at.distance(about) + scale * displacement(morphs, vertex)
    });
    distances.fold(0.0, farther)
}

/// The greater distance; what is unknown is infinitely far.
fn farther(distance: f64, other: f64) -> f64 {
    if other.is_nan() { f64::INFINITY } else { distance.max(other) }
}

/// How far morph targets move a vertex at most.
fn displacement(morphs: &[(f64, Elements<'_>)], vertex: usize) -> f64 {
    morphs.iter().map(|(weight, by)| weight * DVec3::from(by.position(vertex)).length()).sum()
}

/// At least the greatest factor by which a matrix lengthens: the root of a norm of its Gram matrix. Exact if it scales along
/// axes and then turns.
fn norm(matrix: DMat3) -> f64 {
    let gram = matrix.transpose() * matrix;
    let sums = [gram.x_axis, gram.y_axis, gram.z_axis].map(|axis| axis.abs().element_sum());
    sums.into_iter().fold(0.0, farther).sqrt()
}
