//! Elements of glTF accessors, read in place: every range is checked once, before the first element is read.
//!
//! Nothing is copied or allocated, so an accessor that claims 2³¹ elements costs no more than one that has three; and
//! gltf's own iterators, which panic on bad ranges, are not used.

use std::{cell::RefCell, collections::BTreeSet};

use gltf::json::{
    Accessor, Root,
    accessor::{ComponentType, Type},
    validation::Checked,
};

use super::{LoadError, buffers::Bytes};

/// The buffers of a file and what the file says about them.
pub(super) struct Source<'a> {
    pub(super) file: &'a str,
    pub(super) root: &'a Root,
    pub(super) buffers: &'a [Bytes<'a>],
    /// Accessors whose sparse indices were found in order, so that a thousand users cost one look.
    pub(super) ordered: RefCell<BTreeSet<usize>>,
}

/// The elements of one accessor. All element indices below `count` can be read.
pub(super) struct Elements<'a> {
    pub(super) count: usize,
    component: ComponentType,
    /// Numbers in an element.
    width: usize,
    normalized: bool,
    /// `None` is all zeros, which only sparse accessors may be.
    base: Option<Strided<'a>>,
    sparse: Option<Sparse<'a>>,
}

/// Equally spaced elements.
struct Strided<'a> {
    bytes: &'a [u8],
    stride: usize,
}

/// Replacements for some elements, by strictly ascending element index.
struct Sparse<'a> {
    count: usize,
    indices: Strided<'a>,
    index_type: ComponentType,
    values: Strided<'a>,
}

impl<'a> Source<'a> {
    /// The elements of accessor `index`, which must be a VEC3 as positions are.
    pub(super) fn positions(&self, index: usize, from: &str) -> Result<Elements<'a>, LoadError> {
        let accessor = self.accessor(index, from)?;
        let elements = self.elements(index, accessor, Type::Vec3)?;
        if elements.component == ComponentType::U32 {
            return Err(self.error(index, "positions of type u32; use f32".into()));
        }
        Ok(elements)
    }

    /// The elements of accessor `index`, which must be unsigned scalars as vertex indices are.
    pub(super) fn indices(&self, index: usize, from: &str) -> Result<Elements<'a>, LoadError> {
        let accessor = self.accessor(index, from)?;
        let elements = self.elements(index, accessor, Type::Scalar)?;
        if !matches!(elements.component, ComponentType::U8 | ComponentType::U16 | ComponentType::U32) {
            return Err(self.error(index, format!("indices of type {:?}; use u8, u16 or u32", elements.component)));
        }
        Ok(elements)
    }

    /// The elements of accessor `index`, which must be of `shape`. Matrices must be of f32: shorter columns are padded.
    pub(super) fn numbers(&self, index: usize, from: &str, shape: Type) -> Result<Elements<'a>, LoadError> {
        let elements = self.elements(index, self.accessor(index, from)?, shape)?;
        if shape == Type::Mat4 && elements.component != ComponentType::F32 {
            return Err(self.error(index, format!("matrices of type {:?}; use f32", elements.component)));
        }
        Ok(elements)
    }

    fn accessor(&self, index: usize, from: &str) -> Result<&'a Accessor, LoadError> {
        let accessors = &self.root.accessors;
        accessors.get(index).ok_or_else(|| LoadError::Missing {
            file: self.file.into(),
            from: from.into(),
            kind: "accessor",
            index,
            count: accessors.len(),
        })
    }

    fn elements(&self, index: usize, accessor: &Accessor, expected: Type) -> Result<Elements<'a>, LoadError> {
        let error = |reason: String| self.error(index, reason);
        let (Checked::Valid(component), Checked::Valid(shape)) = (&accessor.component_type, &accessor.type_) else {
            return Err(error("unknown component type or shape".into()));
        };
        if *shape != expected {
            return Err(error(format!("has elements of shape {shape:?}, but {expected:?} is needed")));
        }
        let component = component.0;
        let size = component.size() * shape.multiplicity();
        let count = accessor.count.0;
        let offset = accessor.byte_offset.map_or(0, |offset| offset.0);
        let base = match &accessor.buffer_view {
            Some(view) => Some(self.strided(index, view.value(), offset, count, size)?),
            None if accessor.sparse.is_some() => None,
            None => return Err(error("has neither a buffer view nor sparse values".into())),
        };
        let sparse = match &accessor.sparse {
            Some(sparse) => {
                let Checked::Valid(index_type) = &sparse.indices.component_type else {
                    return Err(error("sparse indices of unknown type; use u8, u16 or u32".into()));
                };
                let index_type = index_type.0;
                let (view, at) = (sparse.indices.buffer_view.value(), sparse.indices.byte_offset.0);
                let indices = self.strided(index, view, at, sparse.count.0, index_type.size())?;
                let (view, at) = (sparse.values.buffer_view.value(), sparse.values.byte_offset.0);
                let values = self.strided(index, view, at, sparse.count.0, size)?;
                // The ranges fit the buffers, so the count fits a usize.
                let replaced = Sparse { count: sparse.count.0 as usize, indices, index_type, values };
                if !self.ordered.borrow().contains(&index) {
                    replaced.check(count).map_err(error)?;
                    self.ordered.borrow_mut().insert(index);
                }
                Some(replaced)
            }
            None => None,
        };
        let count = usize::try_from(count).map_err(|_| error(format!("claims {count} elements")))?;
        Ok(Elements { count, component, width: shape.multiplicity(), normalized: accessor.normalized, base, sparse })
    }

    /// `count` elements of `size` bytes from `offset` on in buffer view `view`, if they are all there.
    fn strided(
        &self,
        accessor: usize,
        view: usize,
        offset: u64,
        count: u64,
        size: usize,
    ) -> Result<Strided<'a>, LoadError> {
        let error = |reason: String| self.error(accessor, reason);
        let missing = |kind, index, count| LoadError::Missing {
            file: self.file.into(),
            from: format!("accessor {accessor}"),
            kind,
            index,
            count,
        };
        let views = &self.root.buffer_views;
        let described = views.get(view).ok_or_else(|| missing("buffer view", view, views.len()))?;
        let buffer = described.buffer.value();
        let bytes = self.buffers.get(buffer).ok_or_else(|| missing("buffer", buffer, self.buffers.len()))?.as_slice();

        let start = described.byte_offset.map_or(0, |offset| offset.0);
        let bytes = slice(bytes, start, described.byte_length.0).ok_or_else(|| {
            error(format!(
                "buffer view {view} is {} bytes from {start} on, but buffer {buffer} has {}",
                described.byte_length.0,
                bytes.len()
            ))
        })?;
        let stride = described.byte_stride.map_or(size, |stride| stride.0);
        if stride < size {
            return Err(error(format!("stride of {stride} bytes in buffer view {view}, but an element has {size}")));
        }
        let needed = match count {
            0 => Some(0),
            _ => (count - 1).checked_mul(stride as u64).and_then(|bytes| bytes.checked_add(size as u64)),
        };
        let bytes = needed.and_then(|needed| slice(bytes, offset, needed)).ok_or_else(|| {
            error(format!(
                "claims {count} elements, {stride} bytes apart, from byte {offset} on, but buffer view {view} has {} \
                 bytes",
                bytes.len()
            ))
        })?;
        Ok(Strided { bytes, stride })
    }

    pub(super) fn error(&self, accessor: usize, reason: String) -> LoadError {
        LoadError::Accessor { file: self.file.into(), accessor, reason }
    }
}

pub(super) fn slice(bytes: &[u8], start: u64, length: u64) -> Option<&[u8]> {
    let end = usize::try_from(start.checked_add(length)?).ok()?;
    bytes.get(start as usize..end)
}

impl<'a> Elements<'a> {
    /// Position `i`, in the file's units.
    pub(super) fn position(&self, i: usize) -> [f64; 3] {
        let size = self.component.size();
        let Some(bytes) = self.bytes(i, 3 * size) else { return [0.0; 3] };
        std::array::from_fn(|axis| number(self.component, self.normalized, &bytes[axis * size..]))
    }

    /// Number `axis` of element `i`.
    pub(super) fn number(&self, i: usize, axis: usize) -> f64 {
        let size = self.component.size();
        let bytes = self.bytes(i, self.width * size);
        bytes.map_or(0.0, |bytes| number(self.component, self.normalized, &bytes[axis * size..]))
    }

    /// Number `axis` of element `i`, of an unsigned type.
    pub(super) fn whole(&self, i: usize, axis: usize) -> u32 {
        let size = self.component.size();
        self.bytes(i, self.width * size).map_or(0, |bytes| unsigned(self.component, &bytes[axis * size..]))
    }

    /// What the elements are made of.
    pub(super) fn component_type(&self) -> ComponentType {
        self.component
    }

    /// Vertex index `i`.
    pub(super) fn index(&self, i: usize) -> u32 {
        self.bytes(i, self.component.size()).map_or(0, |bytes| unsigned(self.component, bytes))
    }

    fn bytes(&self, i: usize, size: usize) -> Option<&'a [u8]> {
        if let Some(value) = self.sparse.as_ref().and_then(|sparse| sparse.value(i as u64, size)) {
            return Some(value);
        }
        self.base.as_ref().map(|base| base.element(i, size))
    }
}

impl<'a> Strided<'a> {
    fn element(&self, i: usize, size: usize) -> &'a [u8] {
        &self.bytes[i * self.stride..][..size]
    }
}

impl<'a> Sparse<'a> {
    fn index(&self, i: usize) -> u64 {
        u64::from(unsigned(self.index_type, self.indices.element(i, self.index_type.size())))
    }

    /// Says what is wrong with the indices: binary search needs them ascending, as the specification does.
    fn check(&self, elements: u64) -> Result<(), String> {
        for i in 0..self.count {
            let index = self.index(i);
            if index >= elements {
                return Err(format!("sparse index {i} is {index}, but there are {elements} elements"));
            }
            if i > 0 && index <= self.index(i - 1) {
                return Err(format!("sparse index {i} is {index}, not above the one before; sort them"));
            }
        }
        Ok(())
    }

    fn value(&self, element: u64, size: usize) -> Option<&'a [u8]> {
        let (mut low, mut high) = (0, self.count);
        while low < high {
            let middle = low + (high - low) / 2;
            match self.index(middle).cmp(&element) {
                std::cmp::Ordering::Less => low = middle + 1,
                std::cmp::Ordering::Greater => high = middle,
                std::cmp::Ordering::Equal => return Some(self.values.element(middle, size)),
            }
        }
        None
    }
}

fn unsigned(component: ComponentType, bytes: &[u8]) -> u32 {
    match component {
        ComponentType::U8 => u32::from(bytes[0]),
        ComponentType::U16 => u32::from(u16::from_le_bytes([bytes[0], bytes[1]])),
        _ => u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]),
    }
}

/// One component as a number. Integers come from KHR_mesh_quantization; the normalised ones divide as it says.
fn number(component: ComponentType, normalized: bool, bytes: &[u8]) -> f64 {
    let (value, greatest) = match component {
        ComponentType::F32 => return f64::from(f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])),
        ComponentType::I8 => (f64::from(bytes[0] as i8), 127.0),
        ComponentType::U8 => (f64::from(bytes[0]), 255.0),
        ComponentType::I16 => (f64::from(i16::from_le_bytes([bytes[0], bytes[1]])), 32_767.0),
        ComponentType::U16 => (f64::from(u16::from_le_bytes([bytes[0], bytes[1]])), 65_535.0),
        ComponentType::U32 => (f64::from(unsigned(component, bytes)), 1.0),
    };
    if normalized { (value / greatest).max(-1.0) } else { value }
}
