//! The files that GDAL and QGIS put beside a raster: they are no rasters, and two of them say which cells have a value.

use std::collections::BTreeSet;
use std::io::Read;
use std::path::{Path, PathBuf};

use rockface_core::limits::too_long;

use super::sight::Sight;

/// What is added to the name of a raster: its statistics and more, its mask, its overviews.
const ADDED: [&str; 3] = [".aux.xml", ".msk", ".ovr"];
/// Names of rasters that GDAL puts such files beside end so.
const RASTERS: [&str; 2] = [".tif", ".tiff"];

/// Most bytes of the statistics beside a raster; histograms of many bands and attribute tables are some hundred KiB.
const MOST_BYTES: u64 = 16 << 20;

fn is_raster(path: &Path) -> bool {
    let name = path.to_string_lossy().to_ascii_lowercase();
    RASTERS.iter().any(|end| name.ends_with(end))
}

fn beside(raster: &Path, added: &str) -> PathBuf {
    let mut name = raster.as_os_str().to_owned();
    name.push(added);
    name.into()
}

/// Leaves out of a list of files what only belongs to a raster of the list.
pub fn left_out(mut files: Vec<PathBuf>) -> Vec<PathBuf> {
    let rasters = files.iter().filter(|file| is_raster(file));
    let of_rasters: BTreeSet<PathBuf> = rasters.flat_map(|raster| ADDED.map(|added| beside(raster, added))).collect();
    files.retain(|file| !of_rasters.contains(file));
    files
}

/// What a file beside a raster says of its cells and nobody here reads: the raster alone would be taken for something else.
///
/// # Errors
/// A mask, or a no-data value, in a file of its own.
pub fn check(raster: &Path, sight: &Sight) -> Result<(), String> {
    if !is_raster(raster) {
        return Ok(());
    }
    let mask = beside(raster, ".msk");
    let way = "`gdalwarp -dstnodata nan IN.tif OUT.tif` writes one file that says all";
    if sight.is_file(&mask) {
        return Err(format!("`{}` is a mask, which is not read: {way}", mask.display()));
    }
    let about = beside(raster, ".aux.xml");
    if sight.is_file(&about) {
        let failed = |error: std::io::Error| format!("cannot read `{}`: {error}", about.display());
        let long = || too_long(&format!("`{}`, statistics beside a raster,", about.display()), MOST_BYTES);
        // Before it is hashed: what has the name may be of any size.
        if std::fs::metadata(&about).map_err(failed)?.len() > MOST_BYTES {
            return Err(long());
        }
        sight.hash(&about)?;
        let mut text = Vec::new();
        let read = std::fs::File::open(&about).and_then(|file| file.take(MOST_BYTES + 1).read_to_end(&mut text));
        if read.map_err(failed)? as u64 > MOST_BYTES {
            return Err(long());
        }
        let text = String::from_utf8_lossy(&text);
        if text.contains("<NoDataValue") {
            return Err(format!("`{}` has a no-data value, which is not read: {way}", about.display()));
        }
        // Other programs take this system before that of the raster.
        if text.contains("<SRS") {
            let way = "`gdal_translate IN.tif OUT.tif` writes one file that states it";
            let what = "a coordinate reference system, which is not read";
            return Err(format!("`{}` has {what}: {way}, or remove it if the raster's own is right", about.display()));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_cache::Digest;

    #[test]
    fn what_belongs_to_a_raster_is_left_out_and_what_hides_cells_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let files = ["a.tif", "a.tif.aux.xml", "a.tif.ovr", "b.TIFF", "b.TIFF.msk", "c.aux.xml"];
        assert_eq!(left_out(files.map(at).to_vec()), ["a.tif", "b.TIFF", "c.aux.xml"].map(at));
        let write = |name: &str, text: &str| std::fs::write(at(name), text).unwrap();
        let checked = |name: &str| {
            let hash = |path: &Path| std::fs::read(path).map(|bytes| Digest::of(&bytes)).map_err(|e| e.to_string());
            let sight = Sight::new(&hash);
            (check(&at(name), &sight), sight.looks().len())
        };
        assert_eq!(checked("a.tif"), (Ok(()), 2));
        write("a.tif.aux.xml", "<PAMDataset><PAMRasterBand band=\"1\"><Metadata/></PAMRasterBand></PAMDataset>");
        assert_eq!(checked("a.tif"), (Ok(()), 2));
        write("a.tif.aux.xml", "<PAMDataset><PAMRasterBand band=\"1\"><NoDataValue>-99</NoDataValue>");
        assert!(checked("a.tif").0.unwrap_err().contains("a.tif.aux.xml` has a no-data value, which is not read"));
        write("a.tif.aux.xml", "<PAMDataset><SRS>EPSG:2229</SRS></PAMDataset>");
        assert!(checked("a.tif").0.unwrap_err().contains("has a coordinate reference system, which is not read"));
        let long = std::fs::File::create(at("a.tif.aux.xml")).unwrap();
        long.set_len(3 << 30).unwrap();
        assert!(checked("a.tif").0.unwrap_err().contains("has more than 16384 KiB, and is not read"));
        write("b.TIFF.msk", "");
        assert!(checked("b.TIFF").0.unwrap_err().contains("b.TIFF.msk` is a mask, which is not read"));
        assert_eq!(checked("c.xyz"), (Ok(()), 0));
    }
}
