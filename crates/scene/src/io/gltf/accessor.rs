//! Accessors, checked against their buffer views before anything is allocated.

use super::json::Place;
use super::meshopt;
use crate::io::SceneError;
use serde_json::Value;

/// Names of the compression extension: by vendor, and as ratified.
pub(crate) const MESHOPT: [&str; 2] = ["EXT_meshopt_compression", "KHR_meshopt_compression"];
/// Elements of an accessor that has no buffer view behind it (zeros, or sparse values only).
const MAX_ZERO_ELEMENTS: usize = 1 << 24;

/// A document with its buffers; compressed buffer views are decompressed once.
pub(crate) struct Document<'a> {
    pub root: Place<'a>,
    pub buffers: &'a [Vec<u8>],
    /// Decompressed content per buffer view, where the view is compressed.
    pub decompressed: Vec<Option<Vec<u8>>>,
}

/// An accessor's values as f64 (exact for every component type), element by element.
pub(crate) struct Numbers {
    /// Components per element.
    pub width: usize,
    /// `[element * width + component]`.
    pub values: Vec<f64>,
}

impl Numbers {
    pub fn count(&self) -> usize {
        self.values.len() / self.width
    }

    pub fn rows(&self) -> std::slice::ChunksExact<'_, f64> {
        self.values.chunks_exact(self.width)
    }
}

/// Component types of glTF 2.0 table 3.6.2.2.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    pub fn from_code(place: &Place) -> Result<Self, SceneError> {
        Ok(match place.usize()? {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5125 => Self::U32,
            5126 => Self::F32,
            other => return Err(place.invalid(format!("{other} is not a component type"))),
        })
    }

    pub fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }

    fn read(self, b: &[u8]) -> f64 {
        match self {
            Self::I8 => f64::from(b[0] as i8),
            Self::U8 => f64::from(b[0]),
            Self::I16 => f64::from(i16::from_le_bytes([b[0], b[1]])),
            Self::U16 => f64::from(u16::from_le_bytes([b[0], b[1]])),
            Self::U32 => f64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            Self::F32 => f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])),
        }
    }

    /// glTF 2.0 §3.6.2.2: normalised integers to \[0, 1\] or \[−1, 1\].
    fn normalized(self, x: f64) -> f64 {
        match self {
            Self::I8 => (x / 127.0).max(-1.0),
            Self::U8 => x / 255.0,
            Self::I16 => (x / 32767.0).max(-1.0),
            Self::U16 => x / 65535.0,
            Self::U32 | Self::F32 => x,
        }
    }
}

fn width_of(kind: &Place) -> Result<usize, SceneError> {
    Ok(match kind.value.as_str().unwrap_or("") {
        "SCALAR" => 1,
        "VEC2" => 2,
        "VEC3" => 3,
        "VEC4" => 4,
        "MAT4" => 16,
        other => return Err(kind.invalid(format!("{other:?} is not an accessor type that is read here"))),
    })
}

impl<'a> Document<'a> {
    /// Wraps a loaded document and decompresses its buffer views.
    pub fn new(json: &'a Value, buffers: &'a [Vec<u8>]) -> Result<Self, SceneError> {
        let mut document = Self::plain(json, buffers);
        for view in document.root.list("bufferViews")? {
            let extension = MESHOPT.iter().find_map(|name| view.path(&["extensions", name]));
            let decoded = match extension {
                Some(extension) => Some(meshopt::decode(&extension, document.slice(&extension)?)?),
                None => None,
            };
            document.decompressed.push(decoded);
        }
        Ok(document)
    }

    /// Wraps a document whose buffers are not needed.
    pub fn plain(json: &'a Value, buffers: &'a [Vec<u8>]) -> Self {
        Self { root: Place::root(json), buffers, decompressed: Vec::new() }
    }

    /// The bytes of a buffer view; `from` is the place that refers to it.
    pub fn view(&self, index: usize, from: &Place) -> Result<&[u8], SceneError> {
        if let Some(Some(bytes)) = self.decompressed.get(index) {
            return Ok(bytes);
        }
        self.slice(&self.root.element("bufferViews", index, from)?)
    }

    /// The bytes that a buffer view (or a compressed view's extension) names.
    fn slice(&self, view: &Place) -> Result<&'a [u8], SceneError> {
        let buffer_index = view.need("buffer")?.usize()?;
        let offset = view.usize_or("byteOffset", 0)?;
        let length = view.need("byteLength")?.usize()?;
        let Some(buffer) = self.buffers.get(buffer_index) else {
            let what = format!("refers to buffer {buffer_index}, but the file has {}", self.buffers.len());
            return Err(view.invalid(what));
        };
        offset.checked_add(length).and_then(|end| buffer.get(offset..end)).ok_or_else(|| {
            let what = format!(
                "bytes {offset} to {offset}+{length} are outside buffer {buffer_index}, which has {}",
                buffer.len()
            );
            view.invalid(what)
        })
    }

    /// Reads accessor `from` (a place holding its index).
    pub fn numbers(&self, from: &Place) -> Result<Numbers, SceneError> {
        let index = from.usize()?;
        let accessor = self.root.element("accessors", index, from)?;
        let component = Component::from_code(&accessor.need("componentType")?)?;
        let width = width_of(&accessor.need("type")?)?;
        let count = accessor.need("count")?.usize()?;
        let normalized = accessor.get("normalized").and_then(|n| n.value.as_bool()).unwrap_or(false);
        let mut values = match accessor.get("bufferView") {
            Some(view) => self.packed(&accessor, &view, component, width, count)?,
            None if count <= MAX_ZERO_ELEMENTS => vec![0.0; count * width],
            None => return Err(accessor.limit(format!("{count} elements without data, more than {MAX_ZERO_ELEMENTS}"))),
        };
        if let Some(sparse) = accessor.get("sparse") {
            self.apply_sparse(&sparse, component, width, count, &mut values)?;
        }
        if normalized {
            values.iter_mut().for_each(|x| *x = component.normalized(*x));
        }
        Ok(Numbers { width, values })
    }

    /// Reads accessor `from` as vertex indices.
    pub fn indices(&self, from: &Place) -> Result<Vec<u32>, SceneError> {
        let accessor = self.root.element("accessors", from.usize()?, from)?;
        let component = Component::from_code(&accessor.need("componentType")?)?;
        let whole = matches!(component, Component::U8 | Component::U16 | Component::U32);
        if !whole || width_of(&accessor.need("type")?)? != 1 {
            return Err(accessor.invalid("indices must be single unsigned integers"));
        }
        Ok(self.numbers(from)?.values.iter().map(|&x| x as u32).collect())
    }

    fn packed(
        &self,
        accessor: &Place,
        view_index: &Place,
        component: Component,
        width: usize,
        count: usize,
    ) -> Result<Vec<f64>, SceneError> {
        let index = view_index.usize()?;
        let bytes = self.view(index, view_index)?;
        let element = component.size() * width;
        let view = self.root.element("bufferViews", index, view_index)?;
        let stride = view.usize_or("byteStride", element)?;
        let offset = accessor.usize_or("byteOffset", 0)?;
        if stride < element {
            return Err(view.invalid(format!("byteStride {stride} is less than an element of {element} bytes")));
        }
        if count == 0 {
            return Ok(Vec::new());
        }
        let end =
            (count - 1).checked_mul(stride).and_then(|n| n.checked_add(element)).and_then(|n| n.checked_add(offset));
        if end.is_none_or(|end| end > bytes.len()) {
            let what = format!(
                "{count} elements with stride {stride} from byte {offset} do not fit in buffer view {index} of {} bytes",
                bytes.len()
            );
            return Err(accessor.invalid(what));
        }
        let mut values = Vec::with_capacity(count * width);
        for i in 0..count {
            let row = &bytes[offset + i * stride..][..element];
            values.extend(row.chunks_exact(component.size()).map(|b| component.read(b)));
        }
        Ok(values)
    }

    /// glTF 2.0 §3.6.2.3.
    fn apply_sparse(
        &self,
        sparse: &Place,
        component: Component,
        width: usize,
        count: usize,
        values: &mut [f64],
    ) -> Result<(), SceneError> {
        let changed = sparse.need("count")?.usize()?;
        let indices = sparse.need("indices")?;
        let index_type = Component::from_code(&indices.need("componentType")?)?;
        if !matches!(index_type, Component::U8 | Component::U16 | Component::U32) {
            return Err(indices.invalid("sparse indices must be unsigned integers"));
        }
        let at = self.tight(&indices, index_type, 1, changed)?;
        let new = self.tight(&sparse.need("values")?, component, width, changed)?;
        for (i, row) in at.iter().zip(new.chunks_exact(width)) {
            let i = *i as usize;
            if i >= count {
                return Err(indices.invalid(format!("sparse index {i} of {count} elements")));
            }
            values[i * width..(i + 1) * width].copy_from_slice(row);
        }
        Ok(())
    }

    fn tight(&self, place: &Place, component: Component, width: usize, count: usize) -> Result<Vec<f64>, SceneError> {
        let view_index = place.need("bufferView")?;
        let bytes = self.view(view_index.usize()?, &view_index)?;
        let offset = place.usize_or("byteOffset", 0)?;
        let slice = count
            .checked_mul(width * component.size())
            .and_then(|size| offset.checked_add(size))
            .and_then(|end| bytes.get(offset..end))
            .ok_or_else(|| place.invalid(format!("{count} elements do not fit in a view of {} bytes", bytes.len())))?;
        Ok(slice.chunks_exact(component.size()).map(|b| component.read(b)).collect())
    }
}
