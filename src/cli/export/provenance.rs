//! Where an exported file comes from, written into the file where its format has a place for that, otherwise into a file beside it; and read back.

use std::path::{Path, PathBuf};

use rockface_cache::Digest;
use rockface_core::artefact::{Artefact, Kind};
use rockface_core::format::geotiff;
use serde_json::{Value, json};

use rockface_engine::history::{PastRun, StepDone};

/// What the place in a file is called.
const KEYWORD: &str = "rockface";
/// The item of GDAL's metadata.
const ITEM: &str = "PROVENANCE";
/// The beginning of the comment line in PLY and of the element in SVG.
const COMMENT: &str = "comment rockface provenance ";
const ELEMENT: &str = "<metadata id=\"rockface-provenance\">";
/// The member of GeoJSON.
const MEMBER: &str = "\"provenance\":";
/// What the file beside one is called after it.
const BESIDE: &str = "provenance.json";

/// The facts about an output.
pub fn of(run: &PastRun, done: &StepDone, port: &str, digest: &Digest) -> Value {
    json!({
        "program": run.manifest.made_by(), "exported_by": format!("rockface {}", rockface_engine::version::TEXT),
        "step": done.label(), "port": port, "stage": format!("{} {}", done.stage, done.version), "parameters": *done.parameters,
        "digest": digest.to_string(), "record": done.key.map(|key| key.to_string()),
        "pipeline": run.manifest.pipeline.name, "seed": run.manifest.seed, "run": run.name,
        "command": format!("rockface run .rockface/runs/{}/run.json --target {}", run.name, done.step),
    })
}

/// The file beside one whose format has no place.
pub fn beside(file: &Path) -> PathBuf {
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    file.with_file_name(format!("{name}.{BESIDE}"))
}

/// Text of printable ASCII, as comments and chunks hold it.
fn ascii(facts: &Value) -> String {
    let escaped = |letter: char| {
        let units = letter.encode_utf16(&mut [0; 2]).iter().map(|unit| format!("\\u{unit:04x}")).collect::<String>();
        if (' '..='~').contains(&letter) { letter.to_string() } else { units }
    };
    facts.to_string().chars().map(escaped).collect()
}

/// The file with the facts in it; `None` where the format has no place for them, or the bytes are not what they should be.
pub fn written(kind: Option<Kind>, bytes: &[u8], facts: &Value) -> Option<Vec<u8>> {
    let text = ascii(facts);
    let insert = |at: usize, inserted: &[u8]| Some([&bytes[..at], inserted, &bytes[at..]].concat());
    match kind? {
        Kind::Picture => {
            bytes.starts_with(b"\x89PNG").then(|| insert(PNG_HEADER.min(bytes.len()), &png_chunk(&text)))?
        }
        Kind::Figure => {
            let start = find(bytes, b"<svg")?;
            let end = start + find(&bytes[start..], b">")? + 1;
            insert(end, format!("{ELEMENT}{}</metadata>", xml(&text)).as_bytes())
        }
        Kind::Raster => {
            let Ok(Artefact::Raster(raster)) = Artefact::decode(Kind::Raster, bytes) else { return None };
            geotiff::write_optimised(&raster, &[(ITEM, &text)]).ok()
        }
        Kind::Mesh | Kind::Meshes | Kind::Cloud => {
            let format = bytes.starts_with(b"ply\n").then(|| find(&bytes[4..], b"\n"))?? + 5;
            insert(format, format!("{COMMENT}{text}\n").as_bytes())
        }
        Kind::Inventory => bytes.starts_with(b"{").then(|| insert(1, format!("{MEMBER}{text},").as_bytes()))?,
        _ => None,
    }
}

/// The facts in a file, or in the one beside it.
pub fn read(file: &Path, bytes: &[u8]) -> Option<Value> {
    // All but GeoTIFF have it near the beginning.
    let head = &bytes[..bytes.len().min(1 << 20)];
    let text = if bytes.starts_with(b"\x89PNG") {
        let start = [b"tEXt", KEYWORD.as_bytes(), b"\0"].concat();
        let at = find(head, &start)?;
        let length = u32::from_be_bytes(head[at.checked_sub(4)?..at].try_into().ok()?) as usize;
        latin(head.get(at + start.len()..at + 4 + length)?)
    } else if bytes.starts_with(b"ply\n") {
        between(head, COMMENT, "\n")
    } else if bytes.starts_with(b"II") {
        geotiff::item(bytes, ITEM)
    } else if let Some(text) = between(head, ELEMENT, "</metadata>") {
        Some(text.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&"))
    } else if bytes.starts_with(b"{\"provenance\":") {
        let mut values = serde_json::Deserializer::from_slice(&head[1 + MEMBER.len()..]).into_iter::<Value>();
        return values.next()?.ok();
    } else {
        std::fs::read_to_string(beside(file)).ok()
    };
    serde_json::from_str(&text?).ok()
}

fn find(bytes: &[u8], wanted: &[u8]) -> Option<usize> {
    bytes.windows(wanted.len()).position(|window| window == wanted)
}

fn latin(bytes: &[u8]) -> Option<String> {
    std::str::from_utf8(bytes).ok().map(str::to_owned)
}

/// The text between the first of one and the next of another.
fn between(bytes: &[u8], start: &str, end: &str) -> Option<String> {
    let rest = &bytes[find(bytes, start.as_bytes())? + start.len()..];
    latin(&rest[..find(rest, end.as_bytes())?])
}

fn xml(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

/// Bytes of a PNG up to the end of its first chunk.
const PNG_HEADER: usize = 33;

/// A text chunk with its length and checksum.
fn png_chunk(text: &str) -> Vec<u8> {
    let body = [b"tEXt", KEYWORD.as_bytes(), b"\0", text.as_bytes()].concat();
    let length = (body.len() - 4) as u32;
    [&length.to_be_bytes()[..], &body, &crc32(&body).to_be_bytes()].concat()
}

/// The checksum of PNG (ISO 3309).
fn crc32(bytes: &[u8]) -> u32 {
    let step = |crc: u32, byte: &u8| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 })
    };
    !bytes.iter().fold(!0, step)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_checksum_is_that_of_the_standard() {
        assert_eq!(crc32(b"123456789"), 0xCBF4_3926);
        assert_eq!(crc32(b"IEND"), 0xAE42_6082);
    }

    #[test]
    fn what_is_written_is_read_back() {
        let facts = json!({"step": "a<b>&\u{e9}\u{1f600}", "digest": "00"});
        let png = [&b"\x89PNG\r\n\x1a\n"[..], &[0; 25], b"rest"].concat();
        for (kind, bytes) in [
            (Kind::Picture, png.as_slice()),
            (Kind::Figure, b"<?xml version=\"1.0\"?>\n<svg width=\"3\">\n<g/></svg>"),
            (Kind::Cloud, b"ply\nformat ascii 1.0\nend_header\n"),
            (Kind::Inventory, b"{\"type\":\"FeatureCollection\"}"),
        ] {
            let with = written(Some(kind), bytes, &facts).unwrap();
            assert_eq!(read(Path::new("file"), &with).unwrap(), facts, "{kind}");
        }
        assert_eq!(written(Some(Kind::Table), b"{}", &facts), None);
        assert_eq!(written(Some(Kind::Raster), b"II", &facts), None);
    }
}
