//! GeoTIFF: bands on a square grid as a file that QGIS, GDAL and rasterio open.
//!
//! Files written here are classic little-endian TIFF 6.0 with 256 x 256 tiles, one plane a band, DEFLATE with the
//! floating-point (or horizontal) predictor, `ModelPixelScale` and `ModelTiepoint` for the grid, and the coordinate
//! reference system of the world frame where it is known, otherwise a local engineering system named after the frame. Where
//! the wall frame lies in the world is the item `GEOREFERENCE` of GDAL's metadata. Foreign files may also be striped, interleaved, big-endian, BigTIFF,
//! uncompressed, of 8- to 32-bit integers or 32- or 64-bit floats, and carry a no-data value, and a scale and an offset of each band.

mod cog;
mod read;
mod tags;
mod write;

pub use cog::write_optimised;
pub use read::{DAMAGED, System, read, read_system};
pub use tags::item;
pub use write::write;

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::{read, write};
    use crate::artefact::{Band, Frame, Grid, Raster, Sample};

    fn grid(columns: usize, rows: usize) -> Grid {
        Grid { columns, rows, cell_m: 0.01, left_m: -2.4, top_m: 3.5 }
    }

    fn raster(columns: usize, rows: usize, bands: usize) -> Raster {
        let value = |i: usize| if i.is_multiple_of(7) { f32::NAN } else { (i as f32 * 0.37).sqrt() - 3.0 };
        let band = |b: usize| Band {
            name: format!("b{b} <&\"'> \u{e9}\n"),
            values: (0..columns * rows).map(|i| value(i + b)).collect(),
        };
        Raster {
            grid: grid(columns, rows),
            frame: Frame::World,
            quantity: "difference".into(),
            sample: Sample::Float,
            bands: (0..bands).map(band).collect(),
        }
    }

    #[test]
    fn floats_come_back_bit_for_bit_whatever_the_tiling() {
        for (columns, rows, bands) in [(1, 1, 1), (256, 256, 1), (257, 300, 3), (3, 600, 5), (520, 2, 2)] {
            let raster = raster(columns, rows, bands);
            assert_eq!(read(&write(&raster).unwrap()).unwrap(), raster, "{columns} x {rows} x {bands}");
        }
    }

    #[test]
    fn bytes_come_back_and_other_values_are_refused() {
        let values = (0..300 * 20).map(|i| (i % 256) as f32).collect();
        let mut mask = Raster::single(grid(300, 20), Frame::Wall, "mask", "m", values);
        mask.sample = Sample::Byte;
        assert_eq!(read(&write(&mask).unwrap()).unwrap(), mask);
        for bad in [0.5, -1.0, 256.0, f32::NAN, -0.0] {
            mask.bands[0].values[7] = bad;
            assert!(write(&mask).unwrap_err().0.contains("band `m`"), "{bad}");
        }
    }

    #[test]
    fn words_come_back_whatever_the_tiling_and_other_values_are_refused() {
        let values = (0..300 * 260).map(|i| f32::from((i * 7919 % 65536) as u16)).collect();
        let mut labels = Raster::single(grid(300, 260), Frame::Wall, "label", "id", values);
        labels.sample = Sample::Word;
        assert_eq!(read(&write(&labels).unwrap()).unwrap(), labels);
        for bad in [0.5, -1.0, 65536.0, f32::NAN, -0.0] {
            labels.bands[0].values[7] = bad;
            assert!(write(&labels).unwrap_err().0.contains("0 to 65535"), "{bad}");
        }
    }

    #[test]
    fn a_raster_without_cells_or_with_a_wrong_band_is_refused() {
        let mut empty = raster(2, 2, 1);
        empty.bands.clear();
        assert!(write(&empty).is_err());
        let mut short = raster(2, 2, 1);
        short.bands[0].values.pop();
        assert!(write(&short).unwrap_err().0.contains("3 values"));
    }

    #[test]
    fn heights_are_stated_so_that_others_read_them_and_come_back() {
        use crate::artefact::Georeference;
        use crate::crs::Crs;
        let system = |text: &str| {
            let mut raster = raster(2, 2, 1);
            let crs: Crs = text.parse().unwrap();
            raster.frame = Frame::World.at(Some(Georeference::world(crs.clone())));
            let bytes = write(&raster).unwrap();
            let stated = super::read_system(&bytes).unwrap().stated.unwrap();
            assert!(
                crs.agrees_with(&raster.frame.crs().unwrap().clone()) && stated.states_heights() == crs.has_heights()
            );
            super::tags::geo_keys(raster.frame).0[..3].to_vec()
        };
        // GDAL reads heights from GeoTIFF 1.1 on.
        assert_eq!((system("EPSG:25832"), system("EPSG:25832+7837")), (vec![1, 1, 0], vec![1, 1, 1]));
        let plane = "EPSG:25832".parse::<Crs>().unwrap().wkt();
        let gauge = "VERT_CS[\"our gauge\",VERT_DATUM[\"our gauge\",2005],UNIT[\"metre\",1],AXIS[\"Up\",UP]]";
        assert_eq!(system(&format!("COMPD_CS[\"both\",{plane},{gauge}]")), [1, 1, 0]);
    }

    #[test]
    fn a_tile_that_is_left_out_has_no_value() {
        let whole = raster(8, 6, 1);
        let mut bytes = write(&whole).unwrap();
        // The number of bytes of the only tile, tag 325 of a directory of entries of 12 bytes.
        let at = (8..bytes.len()).find(|at| bytes[*at..].starts_with(&[0x45, 0x01, 4, 0, 1, 0, 0, 0])).unwrap();
        bytes[at + 8..at + 12].fill(0);
        let read = read(&bytes).unwrap();
        assert_eq!((read.grid, read.bands[0].values.iter().all(|value| value.is_nan())), (whole.grid, true));
    }

    #[test]
    fn a_cut_or_damaged_file_is_refused_or_read_but_never_panics() {
        let bytes = write(&raster(8, 6, 2)).unwrap();
        for length in 0..bytes.len() {
            assert!(read(&bytes[..length]).is_err(), "length {length}");
        }
        // Offsets, sizes and types lie behind the tiles, which are the first half.
        for at in (0..8).chain((bytes.len() / 3..bytes.len()).step_by(3)) {
            for value in [0, 1, 0xff] {
                let mut damaged = bytes.clone();
                damaged[at] = value;
                let _ = read(&damaged);
            }
        }
    }

    /// A striped 16-bit file as another program writes it: no metadata, a no-data value, rows of two strips.
    fn striped(nodata: Option<&str>, scale: [f64; 3]) -> Vec<u8> {
        striped_with(nodata, scale, None)
    }

    /// The same with GDAL's metadata.
    fn striped_with(nodata: Option<&str>, scale: [f64; 3], metadata: Option<&str>) -> Vec<u8> {
        use tiff::encoder::{TiffEncoder, colortype::GrayI16};
        use tiff::tags::Tag;
        let mut file = std::io::Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut file).unwrap();
        let mut image = encoder.new_image::<GrayI16>(3, 5).unwrap();
        image.rows_per_strip(4).unwrap();
        let directory = image.encoder();
        directory.write_tag(Tag::ModelPixelScaleTag, scale.as_slice()).unwrap();
        directory.write_tag(Tag::ModelTiepointTag, [0.0, 0.0, 0.0, 7.0, 9.0, 0.0].as_slice()).unwrap();
        if let Some(nodata) = nodata {
            directory.write_tag(Tag::GdalNodata, nodata).unwrap();
        }
        if let Some(metadata) = metadata {
            directory.write_tag(Tag::Unknown(super::tags::GDAL_METADATA), metadata).unwrap();
        }
        let values: Vec<i16> = (0..15).map(|i| i - 4).collect();
        image.write_data(&values).unwrap();
        file.into_inner()
    }

    #[test]
    fn strips_of_integers_become_floats_without_the_no_data_value() {
        let found = read(&striped(Some("-3"), [2.0, 2.0, 0.0])).unwrap();
        let expected = (0..15u8).map(|i| if i == 1 { f32::NAN } else { f32::from(i) - 4.0 }).collect();
        let grid = Grid { columns: 3, rows: 5, cell_m: 2.0, left_m: 7.0, top_m: 9.0 };
        assert_eq!(found, Raster::single(grid, Frame::Wall, "value", "band 1", expected));
        assert!(!read(&striped(None, [2.0, 2.0, 0.0])).unwrap().bands[0].values[1].is_nan());
        assert!(read(&striped(None, [2.0, 1.0, 0.0])).unwrap_err().0.contains("square"));
    }

    #[test]
    fn scale_and_offset_of_a_band_are_applied_but_not_to_the_no_data_value() {
        let with = |scale: &str, offset: &str| {
            let item = |name: &str, text: &str| {
                let role = name.to_lowercase();
                format!("  <Item name=\"{name}\" sample=\"0\" role=\"{role}\">{text}</Item>\n")
            };
            let items = item("OFFSET", offset) + &item("SCALE", scale);
            let metadata = format!("<GDALMetadata>\n{items}</GDALMetadata>\n");
            read(&striped_with(Some("-3"), [2.0, 2.0, 0.0], Some(&metadata)))
        };
        let found = with("0.01", "700").unwrap();
        assert_eq!(found.sample, Sample::Float);
        for (i, value) in found.bands[0].values.iter().enumerate() {
            let expected = ((i as f64 - 4.0) * 0.01 + 700.0) as f32;
            assert!(if i == 1 { value.is_nan() } else { value.to_bits() == expected.to_bits() }, "{i}: {value}");
        }
        let plain = read(&striped(Some("-3"), [2.0, 2.0, 0.0])).unwrap();
        assert_eq!(with("1", "0").unwrap(), plain);
        assert!(with("0,01", "700").unwrap_err().0.contains("band 1 states `0,01` as its scale"));
        assert!(with("1", "nan").unwrap_err().0.contains("gdal_edit.py -offset NUMBER FILE"));
        assert!(with("0", "0").unwrap_err().0.contains("a scale of 0"));
    }

    #[test]
    fn foreign_rasters_are_read() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data/outcrop-survey/real");
        let Ok(bytes) = std::fs::read(format!("{folder}/cmp_00_01.tif")) else {
            eprintln!("skipped: {folder} is not there");
            return;
        };
        let raster = read(&bytes).unwrap();
        assert_eq!((raster.grid.columns, raster.grid.rows), (630, 560));
        assert!((raster.grid.left_m + 2.4).abs() < 1e-9 && (raster.grid.top_m - 3.5).abs() < 1e-9);
        assert_eq!(raster.bands[0].values.iter().filter(|v| !v.is_nan()).count(), 345_689);
    }

    proptest! {
        #[test]
        fn any_float_bits_come_back(values in prop::collection::vec(any::<u32>(), 1..600), columns in 1usize..20) {
            let canonical = |bits: u32| {
                let value = f32::from_bits(bits);
                if value.is_nan() { f32::NAN } else { value }
            };
            let rows = values.len() / columns;
            prop_assume!(rows > 0);
            let values = values[..rows * columns].iter().copied().map(canonical).collect();
            let raster = Raster::single(grid(columns, rows), Frame::Wall, "elevation", "z", values);
            prop_assert_eq!(read(&write(&raster).unwrap()).unwrap(), raster);
        }

        #[test]
        fn garbage_is_refused(mut bytes in prop::collection::vec(any::<u8>(), 0..400)) {
            prop_assert!(read(&bytes).is_err());
            let head = *b"II*\0\x08\0\0\0";
            let length = bytes.len().min(8);
            bytes[..length].copy_from_slice(&head[..length]);
            prop_assert!(read(&bytes).is_err());
        }
    }
}
