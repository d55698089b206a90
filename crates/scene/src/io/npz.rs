//! NumPy archives: a zip of `.npy` arrays (format versions 1–3), read in C order whatever order they are stored in.

use super::{SceneError, load, write_atomically};
use std::io::{Cursor, Read, Write};
use std::path::Path;
use zip::write::SimpleFileOptions;

/// Unpacked bytes of all arrays together.
const MAX_UNPACKED_BYTES: u64 = 4 << 30;
/// Unpacked bytes may exceed packed ones by this factor (deflate cannot do more than about 1032).
const MAX_RATIO: u64 = 1100;
const MAGIC: &[u8] = b"\x93NUMPY";
/// Longest array header that is read [bytes].
const MAX_HEADER: usize = 65_536;

/// An array's elements in C order (last index fastest).
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// `bool`.
    Bool(Vec<bool>),
    /// `uint8`.
    U8(Vec<u8>),
    /// `int8`.
    I8(Vec<i8>),
    /// `uint16`.
    U16(Vec<u16>),
    /// `int16`.
    I16(Vec<i16>),
    /// `uint32`.
    U32(Vec<u32>),
    /// `int32`.
    I32(Vec<i32>),
    /// `uint64`.
    U64(Vec<u64>),
    /// `int64`.
    I64(Vec<i64>),
    /// `float32`; `float16` is widened to it.
    F32(Vec<f32>),
    /// `float64`.
    F64(Vec<f64>),
    /// A kind that is not read (text, objects, records): NumPy's name of it.
    Opaque(String),
}

/// One array of an archive.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Extent along each axis; empty for a single number.
    pub shape: Vec<usize>,
    /// The elements.
    pub values: Values,
}

/// An archive: arrays by name, in file order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Archive {
    /// Names (without `.npy`) and arrays.
    pub arrays: Vec<(String, Array)>,
}

impl Archive {
    /// The array called `name`.
    pub fn get(&self, name: &str) -> Option<&Array> {
        self.arrays.iter().find(|(n, _)| n == name).map(|(_, a)| a)
    }

    /// The array called `name`, or an error that names it.
    ///
    /// # Errors
    /// [`SceneError::Invalid`] if it is not there.
    pub fn need(&self, name: &str) -> Result<&Array, SceneError> {
        self.get(name).ok_or_else(|| {
            let names: Vec<&str> = self.arrays.iter().map(|(n, _)| n.as_str()).collect();
            SceneError::invalid(name, format!("the archive has no such array; it has {}", names.join(", ")))
        })
    }
}

/// Runs an expression over the vector of whichever numeric kind the values are.
macro_rules! each_kind {
    ($values:expr, $v:ident => $body:expr, $opaque:expr) => {
        match $values {
            Values::Bool($v) => $body,
            Values::U8($v) => $body,
            Values::I8($v) => $body,
            Values::U16($v) => $body,
            Values::I16($v) => $body,
            Values::U32($v) => $body,
            Values::I32($v) => $body,
            Values::U64($v) => $body,
            Values::I64($v) => $body,
            Values::F32($v) => $body,
            Values::F64($v) => $body,
            Values::Opaque(_) => $opaque,
        }
    };
}

/// Widening to f64, exact but for 64-bit integers over 2⁵³.
trait Widen {
    fn widen(&self) -> f64;
}
macro_rules! widen {
    ($($t:ty),*) => { $(impl Widen for $t { fn widen(&self) -> f64 { *self as f64 } })* };
}
widen!(u8, i8, u16, i16, u32, i32, u64, i64, f32, f64);
impl Widen for bool {
    fn widen(&self) -> f64 {
        f64::from(u8::from(*self))
    }
}

impl Array {
    /// The elements as f64; empty for kinds that are not read.
    pub fn to_f64(&self) -> Vec<f64> {
        each_kind!(&self.values, v => v.iter().map(Widen::widen).collect(), Vec::new())
    }

    /// The elements as f32; empty for kinds that are not read.
    pub fn to_f32(&self) -> Vec<f32> {
        each_kind!(&self.values, v => v.iter().map(|x| x.widen() as f32).collect(), Vec::new())
    }

    /// The elements, if they are bytes (or truth values, as 0 and 1).
    pub fn to_u8(&self) -> Option<Vec<u8>> {
        match &self.values {
            Values::U8(v) => Some(v.clone()),
            Values::Bool(v) => Some(v.iter().map(|&b| u8::from(b)).collect()),
            _ => None,
        }
    }
}

/// Reads an archive.
///
/// # Errors
/// [`SceneError::Invalid`] for broken archives, [`SceneError::Limit`] for suspiciously large ones, [`SceneError::Io`].
pub fn read(path: impl AsRef<Path>) -> Result<Archive, SceneError> {
    let path = path.as_ref();
    parse(&load(path)?).map_err(|e| e.in_file(path))
}

/// The same from bytes in memory.
///
/// # Errors
/// As [`read`].
pub fn parse(bytes: &[u8]) -> Result<Archive, SceneError> {
    let broken = |what: String| SceneError::invalid("", format!("not a readable npz archive: {what}"));
    let mut zip = zip::ZipArchive::new(Cursor::new(bytes)).map_err(|e| broken(e.to_string()))?;
    let mut archive = Archive::default();
    let mut room = MAX_UNPACKED_BYTES.min(MAX_RATIO.saturating_mul(bytes.len() as u64));
    for i in 0..zip.len() {
        let file = zip.by_index(i).map_err(|e| broken(e.to_string()))?;
        let name = file.name().map_err(|e| broken(e.to_string()))?.trim_end_matches(".npy").to_string();
        let mut data = Vec::new();
        file.take(room + 1).read_to_end(&mut data).map_err(|e| broken(format!("{name}: {e}")))?;
        if data.len() as u64 > room {
            return Err(SceneError::limit(name, "the arrays unpack to more bytes than the archive can honestly hold"));
        }
        room -= data.len() as u64;
        let array = array(&data).map_err(|what| SceneError::invalid(name.clone(), what))?;
        archive.arrays.push((name, array));
    }
    Ok(archive)
}

/// NEP 1: magic, version, header length, a Python dictionary, then the elements.
fn array(data: &[u8]) -> Result<Array, String> {
    if !data.starts_with(MAGIC) {
        return Err("not a .npy array".into());
    }
    let (wide, start) = match data.get(6) {
        Some(1) => (false, 10),
        Some(2 | 3) => (true, 12),
        _ => return Err("an unknown .npy version".into()),
    };
    let length = if wide { data.get(8..12) } else { data.get(8..10) }.ok_or("its header is cut off")?;
    let length = length.iter().rev().fold(0usize, |n, &b| n << 8 | usize::from(b));
    if length > MAX_HEADER {
        return Err(format!("its header claims {length} bytes"));
    }
    let header =
        data.get(start..start + length).and_then(|h| std::str::from_utf8(h).ok()).ok_or("its header is cut off")?;
    let descr = quoted(header, "descr").unwrap_or_default();
    let fortran = after(header, "fortran_order").is_some_and(|s| s.starts_with("True"));
    let shape = shape(header).ok_or("its header has no readable shape")?;
    let count = shape.iter().try_fold(1usize, |n, &d| n.checked_mul(d)).ok_or("its shape is too large")?;
    let body = &data[start + length..];
    let values = decode(&descr, body, count)?;
    let fortran = fortran && shape.len() > 1;
    Ok(Array { values: if fortran { c_order(values, &shape) } else { values }, shape })
}

/// The text after `'key':`.
fn after<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    let at = header.find(&format!("'{key}'"))? + key.len() + 2;
    Some(header[at..].trim_start().strip_prefix(':')?.trim_start())
}

fn quoted(header: &str, key: &str) -> Option<String> {
    let rest = after(header, key)?;
    Some(rest.strip_prefix('\'')?.split('\'').next()?.to_string())
}

fn shape(header: &str) -> Option<Vec<usize>> {
    let inside = after(header, "shape")?.strip_prefix('(')?.split_once(')')?.0;
    inside.split(',').map(str::trim).filter(|s| !s.is_empty()).map(|s| s.trim_end_matches('L').parse().ok()).collect()
}

/// NumPy's type string: byte order, kind, size.
fn decode(descr: &str, body: &[u8], count: usize) -> Result<Values, String> {
    let big = descr.starts_with('>');
    macro_rules! numbers {
        ($kind:ident, $t:ty) => {
            Values::$kind(
                fixed(body, count, descr)?
                    .iter()
                    .map(|b| if big { <$t>::from_be_bytes(*b) } else { <$t>::from_le_bytes(*b) })
                    .collect(),
            )
        };
    }
    Ok(match descr.trim_start_matches(['<', '>', '|', '=']) {
        "b1" => Values::Bool(fixed::<1>(body, count, descr)?.iter().map(|b| b[0] != 0).collect()),
        "u1" => numbers!(U8, u8),
        "i1" => numbers!(I8, i8),
        "u2" => numbers!(U16, u16),
        "i2" => numbers!(I16, i16),
        "u4" => numbers!(U32, u32),
        "i4" => numbers!(I32, i32),
        "u8" => numbers!(U64, u64),
        "i8" => numbers!(I64, i64),
        "f2" => {
            let half = |b: &[u8; 2]| half_to_f32(if big { u16::from_be_bytes(*b) } else { u16::from_le_bytes(*b) });
            Values::F32(fixed::<2>(body, count, descr)?.iter().map(half).collect())
        }
        "f4" => numbers!(F32, f32),
        "f8" => numbers!(F64, f64),
        _ => Values::Opaque(descr.to_string()),
    })
}

/// `count` elements of `N` bytes, checked before anything is allocated.
fn fixed<'a, const N: usize>(body: &'a [u8], count: usize, descr: &str) -> Result<&'a [[u8; N]], String> {
    let bytes = count.checked_mul(N).and_then(|n| body.get(..n));
    let bytes = bytes.ok_or_else(|| format!("{count} elements of kind {descr} do not fit in {} bytes", body.len()))?;
    Ok(bytes.as_chunks::<N>().0)
}

/// IEEE 754 half precision.
fn half_to_f32(h: u16) -> f32 {
    let sign = if h & 0x8000 != 0 { -1.0 } else { 1.0 };
    let (exponent, mantissa) = (i32::from(h >> 10 & 31), f32::from(h & 1023));
    sign * match exponent {
        0 => mantissa * 2f32.powi(-24),
        31 if mantissa == 0.0 => f32::INFINITY,
        31 => f32::NAN,
        e => (1.0 + mantissa / 1024.0) * 2f32.powi(e - 15),
    }
}

fn c_order(values: Values, shape: &[usize]) -> Values {
    match values {
        Values::Bool(v) => Values::Bool(transposed(&v, shape)),
        Values::U8(v) => Values::U8(transposed(&v, shape)),
        Values::I8(v) => Values::I8(transposed(&v, shape)),
        Values::U16(v) => Values::U16(transposed(&v, shape)),
        Values::I16(v) => Values::I16(transposed(&v, shape)),
        Values::U32(v) => Values::U32(transposed(&v, shape)),
        Values::I32(v) => Values::I32(transposed(&v, shape)),
        Values::U64(v) => Values::U64(transposed(&v, shape)),
        Values::I64(v) => Values::I64(transposed(&v, shape)),
        Values::F32(v) => Values::F32(transposed(&v, shape)),
        Values::F64(v) => Values::F64(transposed(&v, shape)),
        opaque => opaque,
    }
}

/// First index fastest → last index fastest.
fn transposed<T: Copy>(v: &[T], shape: &[usize]) -> Vec<T> {
    let mut index = vec![0usize; shape.len()];
    let strides: Vec<usize> = shape.iter().scan(1, |s, &d| Some(std::mem::replace(s, *s * d))).collect();
    (0..v.len())
        .map(|_| {
            let at: usize = index.iter().zip(&strides).map(|(i, s)| i * s).sum();
            for axis in (0..shape.len()).rev() {
                index[axis] += 1;
                if index[axis] < shape[axis] {
                    break;
                }
                index[axis] = 0;
            }
            v[at]
        })
        .collect()
}

/// Writes an archive (deflated, little endian, C order, without time stamps: same arrays, same bytes).
///
/// # Errors
/// [`SceneError::Caller`] for arrays whose shape and length differ or of opaque kind; [`SceneError::Io`].
pub fn write(path: impl AsRef<Path>, archive: &Archive) -> Result<(), SceneError> {
    let bytes = to_bytes(archive)?;
    write_atomically(path, |w| w.write_all(&bytes))
}

/// The bytes of an archive.
///
/// # Errors
/// [`SceneError::Caller`] as in [`write`].
pub fn to_bytes(archive: &Archive) -> Result<Vec<u8>, SceneError> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default()
        .compression_method(zip::CompressionMethod::Deflated)
        .last_modified_time(zip::DateTime::default());
    let failed = |e: &dyn std::fmt::Display| SceneError::Caller(format!("the archive could not be built: {e}"));
    for (name, array) in &archive.arrays {
        let data = npy(array).ok_or_else(|| {
            SceneError::Caller(format!("array {name}: shape and values differ, or its kind cannot be written"))
        })?;
        zip.start_file(format!("{name}.npy"), options).map_err(|e| failed(&e))?;
        zip.write_all(&data).map_err(|e| failed(&e))?;
    }
    Ok(zip.finish().map_err(|e| failed(&e))?.into_inner())
}

fn npy(array: &Array) -> Option<Vec<u8>> {
    fn le<T: Copy, const N: usize>(v: &[T], f: impl Fn(T) -> [u8; N]) -> Vec<u8> {
        v.iter().flat_map(|&x| f(x)).collect()
    }
    let (descr, length, body) = match &array.values {
        Values::Bool(v) => ("|b1", v.len(), le(v, |b| [u8::from(b)])),
        Values::U8(v) => ("|u1", v.len(), v.clone()),
        Values::I8(v) => ("|i1", v.len(), le(v, i8::to_le_bytes)),
        Values::U16(v) => ("<u2", v.len(), le(v, u16::to_le_bytes)),
        Values::I16(v) => ("<i2", v.len(), le(v, i16::to_le_bytes)),
        Values::U32(v) => ("<u4", v.len(), le(v, u32::to_le_bytes)),
        Values::I32(v) => ("<i4", v.len(), le(v, i32::to_le_bytes)),
        Values::U64(v) => ("<u8", v.len(), le(v, u64::to_le_bytes)),
        Values::I64(v) => ("<i8", v.len(), le(v, i64::to_le_bytes)),
        Values::F32(v) => ("<f4", v.len(), le(v, f32::to_le_bytes)),
        Values::F64(v) => ("<f8", v.len(), le(v, f64::to_le_bytes)),
        Values::Opaque(_) => return None,
    };
    if array.shape.iter().product::<usize>() != length {
        return None;
    }
    let extents: String = array.shape.iter().map(|d| format!("{d}, ")).collect();
    let extents = if array.shape.len() == 1 {
        extents.trim_end().to_string()
    } else {
        extents.trim_end_matches(", ").to_string()
    };
    let mut header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({extents}), }}");
    // The data start at a multiple of 64 bytes, after a line feed.
    let padding = (64 - (10 + header.len() + 1) % 64) % 64;
    header.push_str(&" ".repeat(padding));
    header.push('\n');
    let mut out = [MAGIC, &[1, 0], &(header.len() as u16).to_le_bytes()].concat();
    out.extend_from_slice(header.as_bytes());
    out.extend_from_slice(&body);
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_comes_back_as_it_was_written() {
        let kinds = [
            Values::Bool(vec![true, false, true, true, false, false]),
            Values::U8((0..6).collect()),
            Values::I8((-3..3).collect()),
            Values::U16((0..6).map(|i| i * 10_000).collect()),
            Values::I16((-3..3).map(|i| i * 10_000).collect()),
            Values::U32(vec![u32::MAX; 6]),
            Values::I32((-3..3).collect()),
            Values::U64(vec![u64::MAX; 6]),
            Values::I64(vec![i64::MIN; 6]),
            Values::F32(vec![1.5e-30; 6]),
            Values::F64(vec![std::f64::consts::PI; 6]),
        ];
        let arrays =
            kinds.into_iter().enumerate().map(|(i, values)| (format!("a{i}"), Array { shape: vec![2, 3], values }));
        let archive = Archive { arrays: arrays.collect() };
        let bytes = to_bytes(&archive).unwrap();
        assert_eq!(parse(&bytes).unwrap(), archive);
        assert_eq!(bytes, to_bytes(&archive).unwrap());
    }

    #[test]
    fn fortran_order_is_turned_into_c_order() {
        let stored = [0, 10, 20, 1, 11, 21];
        assert_eq!(transposed(&stored, &[3, 2]), [0, 1, 10, 11, 20, 21]);
        let cube: Vec<usize> = (0..24).map(|k| (k % 2) * 100 + (k / 2 % 3) * 10 + k / 6).collect();
        let c = transposed(&cube, &[2, 3, 4]);
        assert!(c.iter().enumerate().all(|(n, &x)| x == (n / 12) * 100 + (n / 4 % 3) * 10 + n % 4), "{c:?}");
    }

    #[test]
    fn half_precision_is_widened_exactly() {
        for (h, x) in
            [(0x3C00, 1.0), (0xC000, -2.0), (0x7BFF, 65504.0), (0x0001, 5.960_464_5e-8), (0x3555, 0.333_251_95)]
        {
            assert_eq!(half_to_f32(h), x);
        }
        assert!(half_to_f32(0x7E00).is_nan());
    }
}
