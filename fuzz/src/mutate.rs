//! Damage: every case is a seed file with a few changes, and follows from the seed of the run and its number alone.

/// The largest case, so that sizes stay the fault of the reader and not of the file.
const LARGEST_BYTES: usize = 64 << 10;
/// Numbers at which sizes and counts go wrong.
const NUMBERS: [u64; 22] = [
    0,
    1,
    2,
    3,
    7,
    16,
    127,
    128,
    255,
    256,
    32_767,
    65_535,
    65_536,
    0x7fff_ffff,
    0x8000_0000,
    0xffff_fffe,
    0xffff_ffff,
    0x1_0000_0000,
    0x7fff_ffff_ffff_ffff,
    0x8000_0000_0000_0000,
    0xffff_ffff_ffff_fff0,
    u64::MAX,
];
/// Numbers that are written out.
const WRITTEN: [&str; 26] = [
    "0",
    "-0",
    "1",
    "-1",
    "2",
    "3",
    "0.5",
    "-0.5",
    "10",
    "255",
    "256",
    "65536",
    "1000000",
    "2147483648",
    "4294967295",
    "4294967296",
    "-9223372036854775808",
    "9223372036854775807",
    "18446744073709551615",
    "18446744073709551616",
    "1e-320",
    "1e30",
    "1e300",
    "-1e308",
    "nan",
    "inf",
];
/// Floating-point numbers that are seldom thought of.
const FLOATS: [f64; 10] =
    [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX, f64::MIN_POSITIVE, 5e-324, -0.0, 1e30, -1e-30, 3e38];

/// A sequence of numbers that follows from its start (`SplitMix64`; Steele, Lea and Flood 2014).
#[derive(Debug, Clone)]
pub struct Draws(u64);

impl Draws {
    /// The numbers of one case of one target.
    pub fn of(seed: u64, target: &str, case: u64) -> Self {
        let text = format!("{seed} {case} {target}");
        let hash = blake3::hash(text.as_bytes());
        Self(hash.as_bytes().first_chunk().map_or(seed, |start| u64::from_le_bytes(*start)))
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A number below a limit; 0 where there is none.
    fn below(&mut self, limit: usize) -> usize {
        (self.next() % limit.max(1) as u64) as usize
    }

    fn of_list<'a, T>(&mut self, list: &'a [T]) -> Option<&'a T> {
        list.get(self.below(list.len()))
    }

    /// A stretch of at most `longest` bytes; short ones are likelier.
    fn stretch(&mut self, length: usize, longest: usize) -> std::ops::Range<usize> {
        let start = self.below(length);
        let scale = 1 << self.below(13);
        let count = 1 + self.below(longest.min(scale));
        start..(start + count).min(length)
    }
}

/// What cases are made of.
#[derive(Debug, Clone, Default)]
pub struct Material {
    /// Files of the format, sound ones and such as once brought a reader down.
    pub files: Vec<Vec<u8>>,
    /// Words of the format.
    pub words: Vec<Vec<u8>>,
}

/// The case of this number.
pub fn case(material: &Material, seed: u64, target: &str, number: u64) -> Vec<u8> {
    let mut draws = Draws::of(seed, target, number);
    let mut bytes = draws.of_list(&material.files).cloned().unwrap_or_default();
    let mut changes = 1 + draws.below(4);
    if draws.below(8) == 0 {
        changes += draws.below(24);
    }
    for _ in 0..changes {
        change(&mut bytes, material, &mut draws);
    }
    bytes.truncate(LARGEST_BYTES);
    bytes
}

fn change(bytes: &mut Vec<u8>, material: &Material, draws: &mut Draws) {
    match draws.below(16) {
        0 => flip(bytes, draws),
        1 | 2 => overwrite(bytes, draws),
        3 => set_byte(bytes, draws),
        4 => drop(bytes.drain(draws.stretch(bytes.len(), 4096))),
        5 => repeat(bytes, draws),
        6 => truncate(bytes, draws),
        7 => splice(bytes, material, draws),
        8..=10 => write_number(bytes, draws),
        11 | 12 => word(bytes, material, draws),
        13 => line(bytes, draws),
        14 => nest(bytes, draws),
        _ => copy(bytes, draws),
    }
}

fn flip(bytes: &mut [u8], draws: &mut Draws) {
    let (at, bit) = (draws.below(bytes.len()), draws.below(8));
    if let Some(byte) = bytes.get_mut(at) {
        *byte ^= 1 << bit;
    }
}

fn set_byte(bytes: &mut [u8], draws: &mut Draws) {
    let (at, value) = (draws.below(bytes.len()), draws.next() as u8);
    if let Some(byte) = bytes.get_mut(at) {
        *byte = value;
    }
}

/// A binary number of 1, 2, 4 or 8 bytes over what is there.
fn overwrite(bytes: &mut [u8], draws: &mut Draws) {
    let width = 1 << draws.below(4);
    let number = draws.of_list(&NUMBERS).copied().unwrap_or_default();
    let float = draws.of_list(&FLOATS).copied().unwrap_or_default();
    let mut written = match (draws.below(4), width) {
        (0, 4) => (float as f32).to_le_bytes().to_vec(),
        (0, 8) => float.to_le_bytes().to_vec(),
        _ => number.to_le_bytes()[..width].to_vec(),
    };
    if draws.below(4) == 0 {
        written.reverse();
    }
    // Fields mostly stand at even places.
    let step = if draws.below(2) == 0 { width } else { 1 };
    let at = draws.below(bytes.len()) / step * step;
    if let Some(place) = bytes.get_mut(at..at + width) {
        place.copy_from_slice(&written);
    }
}

fn repeat(bytes: &mut Vec<u8>, draws: &mut Draws) {
    let stretch = draws.stretch(bytes.len(), 512);
    let most = 1 << draws.below(7);
    let times = 1 + draws.below(most);
    insert(bytes, stretch.end, &bytes[stretch.clone()].repeat(times));
}

fn truncate(bytes: &mut Vec<u8>, draws: &mut Draws) {
    let length = bytes.len();
    let cut = if draws.below(2) == 0 { draws.below(16) } else { draws.below(length) };
    bytes.truncate(length.saturating_sub(cut));
}

/// The start of this file and the end of another.
fn splice(bytes: &mut Vec<u8>, material: &Material, draws: &mut Draws) {
    let Some(other) = draws.of_list(&material.files) else { return };
    let (here, there) = (draws.below(bytes.len()), draws.below(other.len()));
    if draws.below(2) == 0 {
        bytes.truncate(here);
        bytes.extend_from_slice(&other[there..]);
    } else {
        let stretch = draws.stretch(other.len(), 1024);
        insert(bytes, here, &other[stretch]);
    }
}

/// Another number in place of one that is written out.
fn write_number(bytes: &mut Vec<u8>, draws: &mut Draws) {
    let from = draws.below(bytes.len());
    let is_part = |byte: &u8| byte.is_ascii_digit() || matches!(byte, b'.' | b'-');
    let Some(start) = bytes[from..].iter().position(u8::is_ascii_digit).map(|at| from + at) else { return };
    let before = bytes[..start].iter().rev().take_while(|byte| is_part(byte)).count();
    let after = bytes[start..].iter().take_while(|byte| is_part(byte)).count();
    let number = draws.of_list(&WRITTEN).copied().unwrap_or_default();
    bytes.splice(start - before..start + after, number.bytes());
}

/// A word of the format, put in or in place of as many bytes.
fn word(bytes: &mut Vec<u8>, material: &Material, draws: &mut Draws) {
    let Some(word) = draws.of_list(&material.words) else { return write_number(bytes, draws) };
    let at = draws.below(bytes.len() + 1);
    if draws.below(2) == 0 {
        insert(bytes, at, word);
    } else {
        let end = (at + word.len()).min(bytes.len());
        bytes.splice(at..end, word.iter().copied());
    }
}

/// A line gone, doubled, or moved to another place.
fn line(bytes: &mut Vec<u8>, draws: &mut Draws) {
    let lines: Vec<&[u8]> = bytes.split_inclusive(|byte| *byte == b'\n').collect();
    let (from, to) = (draws.below(lines.len()), draws.below(lines.len()));
    let mut changed = lines.clone();
    match draws.below(3) {
        0 if !lines.is_empty() => drop(changed.remove(from)),
        1 => changed.swap_if(from, to),
        _ => lines.get(from).into_iter().for_each(|line| changed.insert(to, line)),
    }
    *bytes = changed.concat();
}

trait SwapIf {
    fn swap_if(&mut self, one: usize, other: usize);
}

impl<T> SwapIf for [T] {
    fn swap_if(&mut self, one: usize, other: usize) {
        if one < self.len() && other < self.len() {
            self.swap(one, other);
        }
    }
}

/// A few bytes very often: what is nested without end, or a line longer than any.
fn nest(bytes: &mut Vec<u8>, draws: &mut Draws) {
    const OPENING: [&str; 12] = ["[", "{\"a\":", "[[", "<a>", "(", "- ", "{a: ", "9", " ", "\n", "<group>", "\"a\":{"];
    let times = 1 << draws.below(14);
    let opening = draws.of_list(&OPENING).copied().unwrap_or_default().as_bytes();
    let at = draws.below(bytes.len() + 1);
    insert(bytes, at, &opening.repeat(times));
}

/// Bytes of one place over those of another.
fn copy(bytes: &mut [u8], draws: &mut Draws) {
    let stretch = draws.stretch(bytes.len(), 64);
    let to = draws.below(bytes.len().saturating_sub(stretch.len()) + 1);
    bytes.copy_within(stretch, to);
}

fn insert(bytes: &mut Vec<u8>, at: usize, what: &[u8]) {
    if bytes.len() + what.len() <= LARGEST_BYTES {
        bytes.splice(at..at, what.iter().copied());
    }
}
