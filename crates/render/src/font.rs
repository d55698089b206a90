//! A small bitmap font for labels: 5×7 letters in 8×8 cells, printable ASCII.

/// Cell size of a glyph [px].
pub const GLYPH_SIZE: usize = 8;

/// Seven rows of five pixels a character from ' ' to '~', one base-32 digit (0–9, A–V) a row, the left pixel in the high bit.
const ROWS: &str = "\
0000000 4444404 AAA0000 AAVAVAA 4FKE5U4 OP248J3 CIK8LID C480000 2488842 8422248 04LEL40 044V440 0000C48 000V000 00000CC 01248G0 \
EHJLPHE 4C4444E EH1248V V2421HE 26AIV22 VGU11HE 68GUHHE V124888 EHHEHHE EHHF12C 0CC0CC0 0CC0C48 248G842 00V0V00 8421248 EH12404 \
EH1DLLE EHHVHHH UHHUHHU EHGGGHE UHHHHHU VGGUGGV VGGUGGG EHGNHHE HHHVHHH E44444E 72222IC HIKOKIH GGGGGGV HRLLHHH HPLJHHH EHHHHHE \
UHHUGGG EHHHLID UHHUKIH FGGE11U V444444 HHHHHHE HHHHHA4 HHHLLRH HHA4AHH HHA4444 V1248GV E88888E 0G84210 E22222E 4AH0000 000000V \
8420000 00E1FHF GGMPHHU 00EGGHE 11DJHHF 00EHVGE 698S888 0FHHF1E GGMPHHH 40C444E 20622IC GGIKOKI C44444E 00QLLHH 00MPHHH 00EHHHE \
00UHUGG 00DJF11 00MPGGG 00EGE1U 88S8896 00HHHJD 00HHHA4 00HHLLA 00HA4AH 00HHF1E 00V248V 2448442 4444444 8442448 008L200";

/// Rows of a character from the top, the left pixel in the highest bit; a box for characters that are not in the font.
pub fn glyph(c: char) -> [u8; GLYPH_SIZE] {
    let mut rows = [0; GLYPH_SIZE];
    let index = (c as usize).wrapping_sub(' ' as usize);
    match ROWS.split_ascii_whitespace().nth(index) {
        Some(digits) => {
            for (row, digit) in rows.iter_mut().zip(digits.chars()) {
                *row = (digit.to_digit(32).unwrap_or(0) << 2) as u8;
            }
        }
        None => rows[..7].copy_from_slice(&[0x7C, 0x44, 0x44, 0x44, 0x44, 0x44, 0x7C]),
    }
    rows
}
