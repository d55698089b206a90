//! PLY: ASCII and binary of both byte orders; positions, normals, colours, texture coordinates, polygons.

use super::text::bad_line;
use super::{Format, ReadOptions, SceneError, plain, polygon};
use crate::{Asset, Look, Mesh, Part};
use glam::{DVec2, DVec3};
use std::path::Path;

/// The PLY reader.
pub struct Ply;

impl Format for Ply {
    fn name(&self) -> &'static str {
        "ply"
    }

    fn extensions(&self) -> &'static [&'static str] {
        &["ply"]
    }

    fn summary(&self) -> &'static str {
        "PLY, ASCII and binary, with vertex colours and texture coordinates"
    }

    fn recognises(&self, bytes: &[u8]) -> bool {
        bytes.starts_with(b"ply\n") || bytes.starts_with(b"ply\r\n")
    }

    fn read(&self, bytes: Vec<u8>, _path: &Path, options: &ReadOptions) -> Result<Asset, SceneError> {
        plain::asset(parse(&bytes)?, vec![Look::default()], options, Vec::new())
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Kind {
    fn named(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The value of `size()` little-endian bytes at the start of `b`.
    fn value(self, b: [u8; 8]) -> f64 {
        let [b0, b1, b2, b3, ..] = b;
        match self {
            Self::I8 => f64::from(b0 as i8),
            Self::U8 => f64::from(b0),
            Self::I16 => f64::from(i16::from_le_bytes([b0, b1])),
            Self::U16 => f64::from(u16::from_le_bytes([b0, b1])),
            Self::I32 => f64::from(i32::from_le_bytes([b0, b1, b2, b3])),
            Self::U32 => f64::from(u32::from_le_bytes([b0, b1, b2, b3])),
            Self::F32 => f64::from(f32::from_le_bytes([b0, b1, b2, b3])),
            Self::F64 => f64::from_le_bytes(b),
        }
    }
}

struct Property {
    name: String,
    kind: Kind,
    /// Kind of the element count, for lists.
    list: Option<Kind>,
}

struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

/// How the numbers of the body are stored.
#[derive(Clone, Copy)]
enum Body<'a> {
    Ascii,
    Binary { big: bool, bytes: &'a [u8] },
}

/// Reads numbers one after the other.
struct Reader<'a> {
    body: Body<'a>,
    words: std::str::SplitAsciiWhitespace<'a>,
    at: usize,
}

impl Reader<'_> {
    fn next(&mut self, kind: Kind) -> Result<f64, String> {
        match self.body {
            Body::Ascii => {
                let word = self.words.next().ok_or("ends too early; it is truncated")?;
                word.parse().map_err(|_| format!("{word:?} is not a number"))
            }
            Body::Binary { big, bytes } => {
                let raw = bytes.get(self.at..self.at + kind.size()).ok_or("ends too early; it is truncated")?;
                self.at += kind.size();
                let mut le = [0; 8];
                le[..raw.len()].copy_from_slice(raw);
                if big {
                    le[..raw.len()].reverse();
                }
                Ok(kind.value(le))
            }
        }
    }
}

fn parse(bytes: &[u8]) -> Result<Mesh, SceneError> {
    let (format, elements, body) = header(bytes)?;
    let text = if format == "ascii" { String::from_utf8_lossy(body).into_owned() } else { String::new() };
    let stored = match format.as_str() {
        "ascii" => Body::Ascii,
        "binary_little_endian" => Body::Binary { big: false, bytes: body },
        "binary_big_endian" => Body::Binary { big: true, bytes: body },
        other => return Err(SceneError::unsupported("", format!("the PLY format {other:?} is not read"))),
    };
    let mut reader = Reader { body: stored, words: text.split_ascii_whitespace(), at: 0 };
    let mut mesh = Mesh::default();
    for element in &elements {
        for k in 0..element.count {
            row(&mut reader, element, &mut mesh)
                .map_err(|what| SceneError::invalid(format!("{} {k} of {}", element.name, element.count), what))?;
        }
    }
    let (vertices, triangles) = (0..mesh.positions.len(), 0..mesh.triangles.len());
    mesh.parts = vec![Part { name: String::new(), vertices, triangles, look: 0, skin: None }];
    Ok(mesh)
}

fn header(bytes: &[u8]) -> Result<(String, Vec<Element>, &[u8]), SceneError> {
    const END: &[u8] = b"end_header";
    let end = bytes.windows(END.len()).position(|w| w == END);
    let end = end.ok_or_else(|| SceneError::invalid("", "the header does not end; it is truncated or no PLY file"))?;
    let body = bytes[end..].iter().position(|&b| b == b'\n').map_or(&[][..], |n| &bytes[end + n + 1..]);
    let text = String::from_utf8_lossy(&bytes[..end]);
    let (mut format, mut elements) = (String::new(), Vec::<Element>::new());
    for (i, line) in text.lines().enumerate() {
        let words: Vec<&str> = line.split_whitespace().collect();
        let kind =
            |name: &str| Kind::named(name).ok_or_else(|| bad_line(i + 1, format!("{name:?} is not a number type")));
        match words[..] {
            ["format", f, ..] => format = f.to_string(),
            ["element", name, count] => {
                let count = count.parse().map_err(|_| bad_line(i + 1, format!("{count:?} is not a count")))?;
                elements.push(Element { name: name.to_string(), count, properties: Vec::new() });
            }
            ["property", "list", count, item, name] => {
                let property = Property { name: name.to_string(), kind: kind(item)?, list: Some(kind(count)?) };
                elements
                    .last_mut()
                    .ok_or_else(|| bad_line(i + 1, "a property without element"))?
                    .properties
                    .push(property);
            }
            ["property", item, name] => {
                let property = Property { name: name.to_string(), kind: kind(item)?, list: None };
                elements
                    .last_mut()
                    .ok_or_else(|| bad_line(i + 1, "a property without element"))?
                    .properties
                    .push(property);
            }
            _ => {}
        }
    }
    // An element without properties takes no bytes, so its count would be unchecked.
    elements.retain(|e| !e.properties.is_empty());
    Ok((format, elements, body))
}

fn row(reader: &mut Reader, element: &Element, mesh: &mut Mesh) -> Result<(), String> {
    let (mut position, mut normal, mut uv, mut color) = ([0.0; 3], [0.0; 3], [0.0; 2], [1.0f64; 3]);
    let (mut has_normal, mut has_uv, mut has_color) = (false, false, false);
    for property in &element.properties {
        if let Some(count) = property.list {
            list(reader, property, count, element, mesh)?;
            continue;
        }
        let x = reader.next(property.kind)?;
        let channel = if property.kind == Kind::U8 { x / 255.0 } else { x };
        match property.name.as_str() {
            "x" => position[0] = x,
            "y" => position[1] = x,
            "z" => position[2] = x,
            "nx" => (normal[0], has_normal) = (x, true),
            "ny" => normal[1] = x,
            "nz" => normal[2] = x,
            "s" | "u" | "texture_u" => (uv[0], has_uv) = (x, true),
            "t" | "v" | "texture_v" => uv[1] = x,
            "red" => (color[0], has_color) = (channel, true),
            "green" => color[1] = channel,
            "blue" => color[2] = channel,
            _ => {}
        }
    }
    if element.name == "vertex" {
        mesh.positions.push(DVec3::from(position));
        if has_normal {
            mesh.normals.push(DVec3::from(normal).normalize_or_zero());
        }
        if has_uv {
            mesh.uvs.push(DVec2::new(uv[0], 1.0 - uv[1]));
        }
        if has_color {
            mesh.colors.push(color.map(|c| crate::image::linear_from_srgb(c.clamp(0.0, 1.0) as f32)));
        }
    }
    Ok(())
}

fn list(
    reader: &mut Reader,
    property: &Property,
    count: Kind,
    element: &Element,
    mesh: &mut Mesh,
) -> Result<(), String> {
    let n = reader.next(count)?;
    if n.is_nan() || n < 0.0 {
        return Err(format!("a list of {n} items"));
    }
    let is_polygon = element.name == "face" && matches!(property.name.as_str(), "vertex_indices" | "vertex_index");
    let (mut corners, mut left) = (Vec::new(), n as u64);
    while left > 0 {
        let x = reader.next(property.kind)?;
        if is_polygon {
            if !(x >= 0.0 && x < mesh.positions.len() as f64) {
                return Err(format!("vertex {x} of {}", mesh.positions.len()));
            }
            corners.push(x as u32);
        }
        left -= 1;
    }
    let points: Vec<DVec3> = corners.iter().map(|&i| mesh.positions[i as usize]).collect();
    mesh.triangles.extend(polygon::triangulate(&points).iter().map(|t| t.map(|k| corners[k])));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = "element vertex 4\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n";
    const CORNERS: [[f32; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];

    #[test]
    fn text_and_both_byte_orders_give_the_same_mesh() {
        let rows: String = CORNERS.iter().map(|[x, y, z]| format!("{x} {y} {z} 255 0 0\n")).collect();
        let ascii = parse(format!("ply\nformat ascii 1.0\n{HEADER}{rows}4 0 1 2 3\n").as_bytes()).unwrap();
        for big in [false, true] {
            let format = if big { "binary_big_endian" } else { "binary_little_endian" };
            let mut bytes = format!("ply\nformat {format} 1.0\n{HEADER}").into_bytes();
            for c in CORNERS {
                bytes.extend(c.iter().flat_map(|x| if big { x.to_be_bytes() } else { x.to_le_bytes() }));
                bytes.extend([255, 0, 0]);
            }
            bytes.push(4);
            bytes.extend([0i32, 1, 2, 3].iter().flat_map(|x| if big { x.to_be_bytes() } else { x.to_le_bytes() }));
            let binary = parse(&bytes).unwrap();
            assert_eq!(binary.positions, ascii.positions);
            assert_eq!(binary.triangles, ascii.triangles);
            assert_eq!(binary.colors[3], [1.0, 0.0, 0.0]);
            assert!(parse(&bytes[..bytes.len() - 1]).is_err());
        }
    }
}
