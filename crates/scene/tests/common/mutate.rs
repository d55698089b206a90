//! Seeded mutation of files, in a child process of bounded memory and time.
#![allow(dead_code, clippy::unwrap_used)]

use serde_json::{Value, json};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::Command;

/// Address space of the child [KiB].
const MEMORY_KIB: u64 = 1 << 20;
/// Longest processor time of one case [ms].
const CASE_MS: f64 = 1000.0;
/// Set in the child.
const CHILD: &str = "ANIMIMIC_FUZZ_CHILD";
/// How many times as many cases are run, for a longer search than a test affords.
const TIMES: &str = "ANIMIMIC_FUZZ_TIMES";

/// Runs the test of this name again in a child of its own that may take a gibibyte and `cpu_secs`; true in that child, where the work
/// is done. Where no shell sets limits the work is done here.
pub fn in_a_small_child(test: &str, cpu_secs: u64) -> bool {
    if std::env::var_os(CHILD).is_some() || cfg!(not(unix)) {
        return true;
    }
    let time = if std::env::var_os(TIMES).is_some() { "unlimited".to_owned() } else { cpu_secs.to_string() };
    let script = format!("ulimit -v {MEMORY_KIB}; ulimit -t {time}; exec \"$0\" \"$@\"");
    let run = Command::new("sh")
        .args(["-c", &script])
        .arg(std::env::current_exe().unwrap())
        .args([test, "--exact", "--nocapture", "--test-threads=1"])
        .env(CHILD, "1")
        .output()
        .unwrap();
    println!("{}", String::from_utf8_lossy(&run.stdout));
    assert!(run.status.success(), "{:?}: {}", run.status, String::from_utf8_lossy(&run.stderr));
    false
}

/// SplitMix64.
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    pub fn below(&mut self, n: usize) -> usize {
        (self.next() % n.max(1) as u64) as usize
    }

    pub fn of<T: Copy>(&mut self, list: &[T]) -> T {
        list[self.below(list.len())]
    }
}

const NUMBERS: &[&[u8]] = &[
    b"0",
    b"-1",
    b"1",
    b"3",
    b"99",
    b"255",
    b"65536",
    b"2000000000",
    b"4294967295",
    b"18446744073709551615",
    b"1e39",
    b"nan",
];

/// One to four changes: a bit, a byte, a cut, a run left out, repeated or moved, four bytes of an extreme number, a number in the text.
pub fn mutated(original: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = original.to_vec();
    for _ in 0..=random.below(4) {
        let at = random.below(bytes.len());
        let end = (at + 1 + random.below(40)).min(bytes.len());
        match random.below(10) {
            0 if !bytes.is_empty() => bytes[at] ^= 1 << random.below(8),
            1 if !bytes.is_empty() => bytes[at] = random.of(&[0, 1, 0x7f, 0x80, 0xff]),
            2 if random.below(3) == 0 => bytes.truncate(at),
            3 => {
                let piece = bytes[at..end].to_vec();
                let to = random.below(bytes.len());
                bytes.splice(to..to, piece);
            }
            4 => drop(bytes.drain(at..end)),
            5 | 6 => {
                let number = random.of(&[0, 1, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff, 0x00ff_ffff, 0x0001_0000u32]);
                let number = if random.below(2) == 0 { number.to_le_bytes() } else { number.to_be_bytes() };
                let end = (at + 4).min(bytes.len());
                bytes[at..end].copy_from_slice(&number[..end - at]);
            }
            _ => {
                let digit = bytes[at..].iter().position(u8::is_ascii_digit).map(|d| at + d);
                if let Some(start) = digit {
                    let length = bytes[start..].iter().position(|b| !b.is_ascii_digit());
                    let end = length.map_or(bytes.len(), |n| start + n);
                    bytes.splice(start..end, random.of(NUMBERS).iter().copied());
                }
            }
        }
    }
    bytes
}

/// One to three changes in a document: a value replaced by an odd one or by another of its values, left out, or there twice.
pub fn mutated_json(original: &Value, random: &mut Random) -> Value {
    let mut document = original.clone();
    for _ in 0..=random.below(3) {
        let places = pointers(&document);
        let place = &places[random.below(places.len())];
        let other = document.pointer(&places[random.below(places.len())]).unwrap().clone();
        let odd = [
            0.0, -1.0, 1.0, 2.0, 3.0, 5.0, 0.5, 99.0, 255.0, 5121.0, 5123.0, 5125.0, 5126.0, 65536.0, 2e9, 1e39, -1e30,
        ];
        let value = match random.below(8) {
            0..3 => number(random.of(&odd)),
            3 => json!(u64::MAX - random.next() % 3),
            4 => random.of(&[&Value::Null, &json!(""), &json!([]), &json!({}), &json!(true), &json!("VEC4")]).clone(),
            _ => other,
        };
        let (parent, key) = place.rsplit_once('/').unwrap();
        match (random.below(6), document.pointer_mut(parent)) {
            (0, Some(Value::Object(o))) => drop(o.shift_remove(key)),
            (0, Some(Value::Array(a))) => drop(a.remove(key.parse().unwrap())),
            (1, Some(Value::Array(a))) => a.push(value),
            _ => *document.pointer_mut(place).unwrap() = value,
        }
    }
    document
}

/// A number as a writer would print it.
fn number(x: f64) -> Value {
    if x.fract() == 0.0 && x.abs() < 1e15 { json!(x as i64) } else { json!(x) }
}

/// Pointers to every value but the whole; the fixtures' keys need no escapes.
fn pointers(document: &Value) -> Vec<String> {
    let mut out = vec![String::new()];
    let mut next = 0;
    while next < out.len() {
        let here = out[next].clone();
        match document.pointer(&here).unwrap() {
            Value::Object(o) => out.extend(o.keys().map(|k| format!("{here}/{k}"))),
            Value::Array(a) => out.extend((0..a.len()).map(|k| format!("{here}/{k}"))),
            _ => {}
        }
        next += 1;
    }
    out.remove(0);
    out
}

/// Processor time of this thread so far [ms]; 0 where the system does not tell.
fn cpu_ms() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split(' ').next().and_then(|ns| ns.parse::<f64>().ok()).unwrap_or(0.0) / 1e6
}

/// Feeds `cases` mutations of the originals, in turn, to `read`, which says whether it accepted them; every outcome but a panic or a
/// delay is fine. The number of the case and the seed make it again.
pub fn hammer(name: &str, originals: &[Vec<u8>], cases: usize, read: impl Fn(Vec<u8>) -> bool) {
    hammer_with(name, originals, cases, |original, random| mutated(original, random), read);
}

/// The same with mutations of one's own, for formats whose check sums or syntax refuse nearly all others.
pub fn hammer_with<T>(
    name: &str,
    originals: &[T],
    cases: usize,
    mutate: impl Fn(&T, &mut Random) -> Vec<u8>,
    read: impl Fn(Vec<u8>) -> bool,
) {
    const SEED: u64 = 7;
    let times: usize = std::env::var(TIMES).ok().and_then(|n| n.parse().ok()).unwrap_or(1);
    let cases = times * cases;
    let mut random = Random(SEED);
    let (mut accepted, mut slowest, begun) = (0, 0.0f64, cpu_ms());
    for case in 0..cases {
        let bytes = mutate(&originals[case % originals.len()], &mut random);
        let start = cpu_ms();
        match catch_unwind(AssertUnwindSafe(|| read(bytes.clone()))) {
            Ok(sound) => accepted += usize::from(sound),
            Err(_) => panic!("{name}: case {case} of seed {SEED} panics: {:?}", String::from_utf8_lossy(&bytes)),
        }
        let took = cpu_ms() - start;
        slowest = slowest.max(took);
        assert!(took < CASE_MS, "{name}: case {case} of seed {SEED} takes {took:.0} ms");
    }
    let total = (cpu_ms() - begun) / 1000.0;
    println!("{name}: {accepted} of {cases} mutations accepted, slowest {slowest:.1} ms, all {total:.1} s");
    assert!(accepted > 0 && accepted < cases, "{name}: the mutations change nothing, or everything");
}
