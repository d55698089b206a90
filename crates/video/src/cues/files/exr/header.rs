//! What stands before the pixels of an OpenEXR file: attributes of each part.

/// Largest side [px], and most samples of a part in all its channels.
const MAX_SIDE: i64 = 16_384;
const MAX_SAMPLES: i64 = 1 << 28;

/// A result that says in a sentence what is wrong with the file.
pub type Parsed<T> = std::result::Result<T, String>;

/// Bytes that are read on and on.
pub struct Bytes<'a> {
    /// The whole file, or the part of it that is read.
    pub all: &'a [u8],
    /// What comes next.
    pub at: usize,
}

impl<'a> Bytes<'a> {
    pub fn take(&mut self, n: usize) -> Parsed<&'a [u8]> {
        let end = self.at.checked_add(n).filter(|e| *e <= self.all.len());
        let end = end.ok_or_else(|| {
            format!("the EXR file ends at byte {} of what it announces; copy it again", self.all.len())
        })?;
        let taken = &self.all[self.at..end];
        self.at = end;
        Ok(taken)
    }

    pub fn i32(&mut self) -> Parsed<i32> {
        let bytes = self.take(4)?;
        Ok(i32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
    }

    /// Text up to a zero byte.
    fn text(&mut self) -> Parsed<&'a str> {
        let length = self.all[self.at..].iter().take(256).position(|b| *b == 0);
        let bytes = self.take(length.ok_or("a name in the EXR file has no end; it is broken, write it again")?)?;
        self.at += 1;
        std::str::from_utf8(bytes).map_err(|_| "a name in the EXR file is no text; it is broken, write it again".into())
    }
}

/// Samples of one kind for every pixel.
#[derive(Clone, Debug)]
pub struct Channel {
    pub name: String,
    /// 0 whole, 1 half, 2 single.
    pub kind: i32,
    pub sampling: [i32; 2],
}

impl Channel {
    pub fn size(&self) -> usize {
        if self.kind == 1 { 2 } else { 4 }
    }
}

/// One picture of the file.
#[derive(Clone, Debug, Default)]
pub struct Part {
    pub name: String,
    pub kind: String,
    pub channels: Vec<Channel>,
    pub compression: u8,
    /// Least x and y, greatest x and y of what there is data for, and of the picture.
    pub data: [i32; 4],
    pub display: [i32; 4],
}

/// Width and height of a window [px].
pub fn size([left, top, right, bottom]: [i32; 4]) -> [i64; 2] {
    [i64::from(right) - i64::from(left) + 1, i64::from(bottom) - i64::from(top) + 1]
}

impl Part {
    /// `None` where the list of parts ends.
    pub fn read(bytes: &mut Bytes) -> Parsed<Option<Self>> {
        let mut part = Self::default();
        let mut empty = true;
        loop {
            let name = bytes.text()?;
            if name.is_empty() {
                return if empty { Ok(None) } else { part.checked().map(Some) };
            }
            empty = false;
            let _type = bytes.text()?;
            let length = bytes.i32()?;
            let all = bytes.take(
                usize::try_from(length).map_err(|_| format!("{name} in the EXR file is broken; write it again"))?,
            )?;
            let mut value = Bytes { all, at: 0 };
            let mut window = || Ok::<_, String>([value.i32()?, value.i32()?, value.i32()?, value.i32()?]);
            match name {
                "dataWindow" => part.data = window()?,
                "displayWindow" => part.display = window()?,
                "compression" => part.compression = *all.first().unwrap_or(&255),
                "name" => part.name = String::from_utf8_lossy(all).into_owned(),
                "type" => part.kind = String::from_utf8_lossy(all).into_owned(),
                "channels" => part.channels = channels(value)?,
                _ => {}
            }
        }
    }

    fn checked(self) -> Parsed<Self> {
        let all = [size(self.data), size(self.display)].concat();
        let [width, height] = size(self.data);
        let samples = width.saturating_mul(height).saturating_mul(self.channels.len() as i64);
        if all.iter().any(|s| !(1..=MAX_SIDE).contains(s)) || samples > MAX_SAMPLES {
            let what = format!("{width}x{height} px in {} channels", self.channels.len());
            return Err(format!(
                "an EXR picture of {what} is not read: save the depth alone, at most {MAX_SIDE} px a side"
            ));
        }
        Ok(self)
    }

    /// Lines that are compressed together.
    pub fn lines_per_chunk(&self) -> Parsed<usize> {
        const NAMES: [&str; 10] = ["none", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "B44A", "DWAA", "DWAB"];
        match self.compression {
            0..=2 => Ok(1),
            3 => Ok(16),
            k => {
                let name = NAMES.get(usize::from(k)).unwrap_or(&"of an unknown kind");
                Err(format!(
                    "the EXR file's compression is {name}: save it with ZIP, as `oiiotool IN.exr --compression zip -o OUT.exr` does"
                ))
            }
        }
    }
}

fn channels(mut bytes: Bytes) -> Parsed<Vec<Channel>> {
    let mut list = Vec::new();
    loop {
        let name = bytes.text()?;
        if name.is_empty() {
            return Ok(list);
        }
        let kind = bytes.i32()?;
        bytes.take(4)?;
        list.push(Channel { name: name.into(), kind, sampling: [bytes.i32()?, bytes.i32()?] });
    }
}
