//! The file of a noise model: a line of magic, a JSON header, strength, elevation, weights of trends, bends, fields and their weights.

use crate::artefact::{CodecError, Contrast, Frame, Grid, Member, Noise, Parametric, ReliefLaw};

/// The first line; a file with another version is learnt anew.
const MAGIC: &str = "rockface noise 18\n";

/// Rasters that each model has once: strength, elevation and weights of trends.
const SINGLE_RASTERS: usize = 3;

/// What is written into the header for whoever reads the file without us.
const LAYOUT: &str = "rows x columns cells from the top left: strength float32 little-endian (px), elevation float32 (m, NaN = unknown), \
                      weight in the least squares of a trend float32 (1); \
                      then for each bend of a trend what comes with it float32 (m/m), \
                      then for each field of the members float32 (1), then their weights uint8 (127 = 1; 128 is added in a gap)";

#[derive(serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    frame: Frame,
    columns: usize,
    rows: usize,
    cell_m: f64,
    left_m: f64,
    top_m: f64,
    donors: usize,
    length_cells: f64,
    common_share: f64,
    bad_share: f64,
    class_log_strength: Vec<f64>,
    jitter: f64,
    sharpness: u32,
    contrast: Contrast,
    log_gain: Vec<f64>,
    relief: ReliefLaw,
    asymmetry_gain: [f64; 3],
    gap_gain: f64,
    gap_variety: f64,
    skewness_gain: f64,
    parametric: Option<Box<Parametric>>,
    members: Vec<Member>,
    orders: [Vec<usize>; 2],
    bend_shapes: usize,
    fields: usize,
    weights: usize,
    layout: String,
}

/// Writes a noise model.
pub fn write(noise: &Noise) -> Result<Vec<u8>, CodecError> {
    noise.check()?;
    let grid = noise.grid;
    let header = Header {
        frame: noise.frame,
        columns: grid.columns,
        rows: grid.rows,
        cell_m: grid.cell_m,
        left_m: grid.left_m,
        top_m: grid.top_m,
        donors: noise.donors,
        length_cells: noise.length_cells,
        common_share: noise.common_share,
        bad_share: noise.bad_share,
        class_log_strength: noise.class_log_strength.clone(),
        jitter: noise.jitter,
        sharpness: noise.sharpness,
        contrast: noise.contrast.clone(),
        log_gain: noise.log_gain.clone(),
        relief: noise.relief,
        asymmetry_gain: noise.asymmetry_gain,
        gap_gain: noise.gap_gain,
        gap_variety: noise.gap_variety,
        skewness_gain: noise.skewness_gain,
        parametric: noise.parametric.clone(),
        members: noise.members.clone(),
        orders: noise.orders.clone(),
        bend_shapes: noise.bend_shapes.len(),
        fields: noise.fields.len(),
        weights: noise.weights.len(),
        layout: LAYOUT.to_owned(),
    };
    let header = serde_json::to_string(&header).map_err(|e| CodecError(e.to_string()))?;
    // A number that is not finite would become `null` and be refused when it is read.
    serde_json::from_str::<Header>(&header)
        .map_err(|e| CodecError(format!("noise model: a number is not finite: {e}")))?;
    let body = size(grid.cells(), noise.bend_shapes.len() + noise.fields.len(), noise.weights.len()).unwrap_or(0);
    let mut bytes = Vec::with_capacity(MAGIC.len() + header.len() + 1 + body);
    bytes.extend_from_slice(MAGIC.as_bytes());
    bytes.extend_from_slice(header.as_bytes());
    bytes.push(b'\n');
    let single = [&noise.strength, &noise.elevation, &noise.trend_weights].into_iter();
    for raster in single.chain(&noise.bend_shapes).chain(&noise.fields) {
        bytes.extend(raster.iter().flat_map(|value| value.to_le_bytes()));
    }
    noise.weights.iter().for_each(|weights| bytes.extend_from_slice(weights));
    Ok(bytes)
}

/// Reads a noise model.
pub fn read(bytes: &[u8]) -> Result<Noise, CodecError> {
    let rest = bytes
        .strip_prefix(MAGIC.as_bytes())
        .ok_or_else(|| CodecError(format!("not a `{}` file: learn the model anew (learn-noise)", MAGIC.trim_end())))?;
    let end = rest.iter().position(|b| *b == b'\n').ok_or_else(|| CodecError::new("noise file: header without end"))?;
    let header: Header =
        serde_json::from_slice(&rest[..end]).map_err(|e| CodecError(format!("noise file: bad header: {e}")))?;
    let body = &rest[end + 1..];
    let grid = Grid {
        columns: header.columns,
        rows: header.rows,
        cell_m: header.cell_m,
        left_m: header.left_m,
        top_m: header.top_m,
    };
    let cells = grid.columns.checked_mul(grid.rows).filter(|cells| *cells > 0);
    let rasters = header.fields.checked_add(header.bend_shapes);
    let expected = cells.zip(rasters).and_then(|(cells, rasters)| size(cells, rasters, header.weights));
    let (Some(cells), Some(expected)) = (cells, expected) else {
        return Err(CodecError::new("noise file: impossible size"));
    };
    if body.len() != expected {
        let (found, w, h, n, m) = (body.len(), grid.columns, grid.rows, header.fields, header.weights);
        let bends = header.bend_shapes;
        return Err(CodecError(format!(
            "noise file: {bends} bends, {n} fields and {m} weights of {w} x {h} cells need {expected} bytes, found {found}; it is cut short or damaged"
        )));
    }
    let (floats, weights) = body.split_at(4 * cells * (SINGLE_RASTERS + header.bend_shapes + header.fields));
    let value = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
    let mut rasters = floats.chunks_exact(4 * cells).map(|raster| raster.chunks_exact(4).map(value).collect());
    let [strength, elevation, trend_weights] = [(); SINGLE_RASTERS].map(|()| rasters.next().unwrap_or_default());
    let noise = Noise {
        frame: header.frame,
        grid,
        donors: header.donors,
        length_cells: header.length_cells,
        common_share: header.common_share,
        bad_share: header.bad_share,
        class_log_strength: header.class_log_strength,
        jitter: header.jitter,
        sharpness: header.sharpness,
        contrast: header.contrast,
        log_gain: header.log_gain,
        relief: header.relief,
        asymmetry_gain: header.asymmetry_gain,
        gap_gain: header.gap_gain,
        gap_variety: header.gap_variety,
        skewness_gain: header.skewness_gain,
        parametric: header.parametric,
        members: header.members,
        orders: header.orders,
        strength,
        elevation,
        trend_weights,
        bend_shapes: rasters.by_ref().take(header.bend_shapes).collect(),
        fields: rasters.collect(),
        weights: weights.chunks_exact(cells).map(<[u8]>::to_vec).collect(),
    };
    noise.check()?;
    if header.layout != LAYOUT {
        return Err(CodecError::new("noise file: a layout of another version"));
    }
    Ok(noise)
}

/// Bytes of the rasters of a file.
fn size(cells: usize, rasters: usize, weights: usize) -> Option<usize> {
    let bytes_a_cell = rasters.checked_add(SINGLE_RASTERS)?.checked_mul(4)?.checked_add(weights)?;
    cells.checked_mul(bytes_a_cell)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artefact::{LateralShift, LevelContrast, LevelFigures, PlaceSpectrum};

    fn sample() -> Noise {
        let member = |name: &str, bad: bool| Member {
            name: name.into(),
            bad,
            log_strength: vec![0.1],
            trend_m: [0.001, -0.002, 0.003, 0.0004, 0.0, -0.0005, 0.0001, 0.0, -0.0002, 0.0003],
            log_amplitude: vec![0.2, -0.3],
            field_log_amplitude: vec![0.0, 0.1],
            skewness: -0.2,
        };
        Noise {
            frame: Frame::Wall,
            grid: Grid { columns: 2, rows: 1, cell_m: 0.01, left_m: -1.0, top_m: 0.1 },
            donors: 8,
            length_cells: 60.0,
            common_share: 0.3,
            bad_share: 0.05,
            class_log_strength: vec![-1.2],
            jitter: 0.2,
            sharpness: 4,
            contrast: Contrast {
                finest_cells: 0.8,
                levels: vec![LevelContrast {
                    own_power: [0.2, 0.1, 0.0],
                    local_power: [-0.1, 0.2],
                    log_gain: [0.01, -0.02, 0.0],
                    growth: [[0.3, 0.0, 0.0, 0.1, 0.2]; 5],
                    usual: LevelFigures { log_rms: [-0.4, -0.5, -1.0], unevenness: [1.5, 1.4, 1.3, -1.0, -1.2] },
                    drawn: LevelFigures { log_rms: [-0.5, -0.4, -1.1], unevenness: [1.6, 1.4, 1.2, -1.1, -1.2] },
                    deviation: [0.01, 0.02, 0.03, 0.04, 0.05],
                }],
            },
            log_gain: vec![0.0, 0.1],
            relief: ReliefLaw { flat_px: 0.2, gain_px_m: 3.0, window_cells: 4 },
            asymmetry_gain: [1.3, 1.2, 0.0],
            gap_gain: 0.8,
            gap_variety: 1.3,
            skewness_gain: 1.7,
            parametric: None,
            members: vec![member("a", false), member("b", true)],
            orders: [vec![0], vec![0]],
            strength: vec![0.3, 0.4],
            elevation: vec![f32::NAN, 1.5],
            bend_shapes: vec![vec![0.25, -0.5]; 7],
            trend_weights: vec![0.5, 2.0],
            fields: vec![vec![0.5, -0.25], vec![1.0, -0.0]],
            weights: vec![vec![127, 0], vec![127, 192]],
        }
    }

    #[test]
    fn comes_back_bit_for_bit() {
        assert_eq!(read(&write(&sample()).unwrap()).unwrap(), sample());
        let bare = Noise { bend_shapes: Vec::new(), fields: Vec::new(), weights: Vec::new(), ..sample() };
        assert_eq!(read(&write(&bare).unwrap()).unwrap(), bare);
        let parametric = Noise { parametric: Some(Box::new(parametric())), ..bare };
        assert_eq!(read(&write(&parametric).unwrap()).unwrap(), parametric);
    }

    fn parametric() -> Parametric {
        let spectrum = |log_strength: f64| PlaceSpectrum { log_strength, log_amplitude: vec![0.5, log_strength] };
        let shift =
            LateralShift { deviation_cells: 1.0, length_cells: 8.0, across_cells: 2.0, share: 0.4, half_m: 0.01 };
        Parametric { spectra: [-1.5, -0.5].map(spectrum).into(), shift: Some(shift) }
    }

    #[test]
    fn spectra_and_shifts_that_do_not_fit_are_refused() {
        let bare = Noise { fields: Vec::new(), weights: Vec::new(), ..sample() };
        let refused = |parametric: Parametric| {
            let noise = Noise { parametric: Some(Box::new(parametric)), ..bare.clone() };
            write(&noise).unwrap_err().0
        };
        let with_shift = |change: fn(&mut LateralShift)| {
            let mut parametric = parametric();
            parametric.shift.iter_mut().for_each(change);
            parametric
        };
        assert!(refused(with_shift(|shift| shift.share = 1.5)).contains("a share of at most 1"));
        assert!(refused(with_shift(|shift| shift.across_cells = 0.0)).contains("positive lengths"));
        let mut short = parametric();
        short.spectra[1].log_amplitude.pop();
        let mut turned = parametric();
        turned.spectra.reverse();
        for parametric in [short, turned, Parametric { spectra: Vec::new(), ..parametric() }] {
            assert!(refused(parametric).contains("spectra by place"));
        }
        let fields = Noise { parametric: Some(Box::new(parametric())), ..sample() };
        assert!(write(&fields).unwrap_err().0.contains("it has fields, and spectra"));
    }

    #[test]
    fn a_cut_file_is_refused_at_every_length() {
        crate::testing::refuses_every_beginning(&write(&sample()).unwrap(), read);
    }

    #[test]
    fn parts_that_do_not_fit_are_refused_by_name() {
        let mut noise = sample();
        noise.members[1].log_amplitude.pop();
        assert!(write(&noise).unwrap_err().0.contains("`b` has [1, 1, 2] values"));
        let noise = Noise { weights: Vec::new(), ..sample() };
        assert!(write(&noise).unwrap_err().0.contains("2 fields and 0 weights"));
        for order in [vec![], vec![1], vec![0, 1], vec![0, 0]] {
            let noise = Noise { orders: [vec![0], order], ..sample() };
            assert!(write(&noise).unwrap_err().0.contains("an order of replicates"));
        }
        let noise = Noise { bend_shapes: vec![vec![0.1, 0.2]], ..sample() };
        assert!(write(&noise).unwrap_err().0.contains("1 shapes of bends for 7 factors"));
        let noise = Noise { sharpness: 0, ..sample() };
        assert!(write(&noise).unwrap_err().0.contains("sharpness must be"));
        let noise = Noise { log_gain: vec![0.0, 9.0], ..sample() };
        assert!(write(&noise).unwrap_err().0.contains("out of range"));
        let noise = Noise { contrast: Contrast { finest_cells: -1.0, ..sample().contrast }, ..sample() };
        assert!(write(&noise).unwrap_err().0.contains("contrast or a gain"));
        let noise = Noise { strength: vec![0.1, f32::NAN], ..sample() };
        assert!(write(&noise).unwrap_err().0.contains("not finite"));
    }
}
