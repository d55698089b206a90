//! Words and numbers of line-based text formats, with line numbers for messages.

use super::SceneError;

/// Bytes as text; broken UTF-8 (names in old encodings) is replaced, not refused.
pub(crate) fn lines(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A broken rule on a line (counted from 1).
pub(crate) fn bad_line(line: usize, what: impl Into<String>) -> SceneError {
    SceneError::invalid(format!("line {line}"), what)
}

/// A number; infinities and NaN pass and are judged by the mesh checks.
pub(crate) fn number(word: Option<&str>, line: usize) -> Result<f64, SceneError> {
    let word = word.ok_or_else(|| bad_line(line, "a number is missing"))?;
    word.parse().map_err(|_| bad_line(line, format!("{word:?} is not a number")))
}

/// Three numbers.
pub(crate) fn triple<'a>(words: &mut impl Iterator<Item = &'a str>, line: usize) -> Result<glam::DVec3, SceneError> {
    Ok(glam::DVec3::new(number(words.next(), line)?, number(words.next(), line)?, number(words.next(), line)?))
}
