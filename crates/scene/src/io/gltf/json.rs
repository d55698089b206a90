//! A place in a JSON document that knows its own pointer, so that every message can say where it is.

use crate::io::SceneError;
use serde_json::Value;

/// A value in the document and its JSON pointer (RFC 6901).
#[derive(Clone)]
pub(crate) struct Place<'a> {
    pub value: &'a Value,
    pub pointer: String,
}

impl<'a> Place<'a> {
    pub fn root(value: &'a Value) -> Self {
        Self { value, pointer: String::new() }
    }

    /// The member `key`, unless absent or null.
    pub fn get(&self, key: &str) -> Option<Place<'a>> {
        let value = self.value.get(key).filter(|v| !v.is_null())?;
        Some(Place { value, pointer: format!("{}/{key}", self.pointer) })
    }

    /// The member `key`, which must be there.
    pub fn need(&self, key: &str) -> Result<Place<'a>, SceneError> {
        self.get(key).ok_or_else(|| self.invalid(format!("\"{key}\" is missing")))
    }

    /// Follows several keys.
    pub fn path(&self, keys: &[&str]) -> Option<Place<'a>> {
        keys.iter().try_fold(self.clone(), |place, key| place.get(key))
    }

    /// The elements of an array.
    pub fn items(&self) -> Result<Vec<Place<'a>>, SceneError> {
        let array = self.value.as_array().ok_or_else(|| self.invalid("should be an array"))?;
        Ok(array
            .iter()
            .enumerate()
            .map(|(i, value)| Place { value, pointer: format!("{}/{i}", self.pointer) })
            .collect())
    }

    /// The elements of the array under `key`; none if it is absent.
    pub fn list(&self, key: &str) -> Result<Vec<Place<'a>>, SceneError> {
        self.get(key).map_or(Ok(Vec::new()), |p| p.items())
    }

    /// Number of elements under `key`, 0 if it is absent or no array.
    pub fn len_of(&self, key: &str) -> usize {
        self.value.get(key).and_then(Value::as_array).map_or(0, Vec::len)
    }

    /// The element `index` of the top-level array `key`; `from` is the place that refers to it.
    pub fn element(&self, key: &str, index: usize, from: &Place) -> Result<Place<'a>, SceneError> {
        let value = self.value.get(key).and_then(|a| a.get(index)).filter(|v| v.is_object());
        let value = value
            .ok_or_else(|| from.invalid(format!("refers to {key} {index}, but the file has {}", self.len_of(key))))?;
        Ok(Place { value, pointer: format!("{}/{key}/{index}", self.pointer) })
    }

    /// A non-negative integer.
    pub fn usize(&self) -> Result<usize, SceneError> {
        let exact = self.value.as_u64();
        // Some writers print integers as 3.0.
        let whole = || self.value.as_f64().filter(|x| x.fract() == 0.0 && (0.0..9e15).contains(x)).map(|x| x as u64);
        let n = exact.or_else(whole).ok_or_else(|| self.invalid("should be a non-negative integer"))?;
        usize::try_from(n).map_err(|_| self.invalid("is too large"))
    }

    /// The non-negative integer under `key`, or a default.
    pub fn usize_or(&self, key: &str, default: usize) -> Result<usize, SceneError> {
        self.get(key).map_or(Ok(default), |p| p.usize())
    }

    /// A number that fits in an f32, as all numbers of glTF must.
    pub fn number(&self) -> Result<f64, SceneError> {
        let x = self.value.as_f64().ok_or_else(|| self.invalid("should be a number"))?;
        if x.is_finite() && x.abs() <= f64::from(f32::MAX) {
            Ok(x)
        } else {
            Err(self.invalid(format!("{x:e} is outside the range of 32-bit floats")))
        }
    }

    /// The number under `key`, or a default.
    pub fn number_or(&self, key: &str, default: f64) -> Result<f64, SceneError> {
        self.get(key).map_or(Ok(default), |p| p.number())
    }

    /// `N` numbers under `key`, or a default.
    pub fn numbers_or<const N: usize>(&self, key: &str, default: [f64; N]) -> Result<[f64; N], SceneError> {
        let Some(place) = self.get(key) else { return Ok(default) };
        let items = place.items()?;
        if items.len() != N {
            return Err(place.invalid(format!("should hold {N} numbers, holds {}", items.len())));
        }
        let mut out = default;
        for (o, item) in out.iter_mut().zip(&items) {
            *o = item.number()?;
        }
        Ok(out)
    }

    /// The string under `key`, or "".
    pub fn text(&self, key: &str) -> &'a str {
        self.value.get(key).and_then(Value::as_str).unwrap_or("")
    }

    pub fn invalid(&self, what: impl Into<String>) -> SceneError {
        SceneError::invalid(self.pointer.clone(), what)
    }

    pub fn unsupported(&self, what: impl Into<String>) -> SceneError {
        SceneError::unsupported(self.pointer.clone(), what)
    }

    pub fn limit(&self, what: impl Into<String>) -> SceneError {
        SceneError::limit(self.pointer.clone(), what)
    }
}
