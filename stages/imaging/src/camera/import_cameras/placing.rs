//! Where the centres that a file holds are: in the system it states, or brought to the one that is wanted, and shifted.

use super::ImportCamerasParams;
use crate::camera::camera_files::CameraFile;
use crate::camera::geocentric;
use crate::camera::geocentric::AtBlock;
use crate::camera::map_projection::{Datum, MapProjection, place_deg};
use rockface_core::artefact::{Frame, Georeference};
use rockface_core::crs::wkt::Node;
use rockface_core::crs::{Crs, DatumShift, Kind, Plane, Stated, Tool, is_like_wgs_84, settle, utm_zone};
use rockface_core::{Context, StageError};

/// What is off by more than this in the images is warned of, pixels.
const NOTABLE_PX: f64 = 0.5;
/// A map whose lengths are off by more than this is no map of the site.
const MOST_OFF: f64 = 0.1;

/// Brings centres, and their covariance in the same file, to metres of the system that is stated or wanted, and shifts them.
pub fn place(file: &mut CameraFile, params: &ImportCamerasParams, context: &Context) -> Result<(), StageError> {
    match file.geocentric.take() {
        Some(reference) => to_map(file, &reference, params, context)?,
        None => to_metres(file, params, context)?,
    }
    let by = params.offset_m;
    if by.iter().all(|shift| shift.abs() <= 0.0) {
        return Ok(());
    }
    if file.cameras.frame == Frame::Wall && file.cameras.frame.georeference().is_some() {
        let text = format!(
            "`{}` states how its wall frame lies in the world, which `offset_m` would make untrue",
            params.path.0
        );
        return Err(StageError::new(text).hint("leave it out, or take `georeference` out of the frame in the file"));
    }
    for image in &mut file.cameras.images {
        image.centre_m.iter_mut().zip(by).for_each(|(coordinate, shift)| *coordinate += shift);
    }
    Ok(())
}

/// Centres, and their covariance in the same file, in metres of the system that is stated.
fn to_metres(file: &mut CameraFile, params: &ImportCamerasParams, context: &Context) -> Result<(), StageError> {
    let stated = file.stated.take();
    let says_nothing = stated.is_none() && params.crs.is_none();
    if file.cameras.frame != Frame::World || says_nothing {
        return Ok(());
    }
    let shifted = |at: [f64; 3]| [0, 1, 2].map(|axis| at[axis] + params.offset_m[axis]);
    let first = file.cameras.images.first().map(|image| shifted(image.centre_m));
    let about = (Tool::Other, first);
    let settled = settle(&params.path.0, [stated, None], params.crs.as_ref(), about, context)?;
    for image in &mut file.cameras.images {
        image.centre_m = settled.point(image.centre_m);
    }
    file.cameras.frame = settled.frame();
    if let Some(covariance) = &mut file.covariance {
        covariance.frame = file.cameras.frame;
        let length = |name: &String| match name.rsplit('.').next() {
            Some("X" | "Y") => settled.horizontal,
            Some("Z") => settled.vertical,
            _ => 1.0,
        };
        let metres: Vec<f64> = covariance.parameters.iter().map(length).collect();
        for (row, of_row) in covariance.matrix.iter_mut().zip(&metres) {
            row.iter_mut().zip(&metres).for_each(|(value, of_column)| *value *= of_row * of_column);
        }
    }
    Ok(())
}

/// Geocentric centres brought to the map that is wanted, else to that of the chunk.
fn to_map(
    file: &mut CameraFile,
    reference: &Stated,
    params: &ImportCamerasParams,
    context: &Context,
) -> Result<(), StageError> {
    let path = &params.path.0;
    if file.cameras.frame != Frame::World {
        let text = format!(
            "the chunk of `{path}` is referenced to `{}`, so its centres are geocentric and not in a wall frame",
            reference.name
        );
        return Err(StageError::new(text)
            .hint("leave `frame: wall` out, and take model and cameras to the wall with `transform-crs`"));
    }
    let first = file.cameras.images.first().map(|image| image.centre_m).unwrap_or_default();
    let crs = wanted(reference, first, params, context)?;
    let of_crs = Datum::of(&Node::parse(&crs.wkt()).map_err(StageError::new)?);
    let of_chunk = reference.node.as_ref().and_then(Datum::of);
    let shift = datum_shift(of_chunk, of_crs, (path, &crs), context)?;
    let map = MapProjection::of(&crs).map_err(|projection| {
        let text =
            format!("cameras cannot be brought to {crs} ({}): its projection `{projection}` is not computed here", crs.name());
        StageError::new(text).hint(format!(
            "{} are: give the UTM zone of the site as `crs`, or export model and cameras from a local system (metres); the zone is {}",
            Plane::COMPUTED,
            zone(first)
        ))
    })?;
    let at = geocentric::to_map(&mut file.cameras, file.covariance.as_mut(), &map, shift.as_ref())
        .map_err(|error| error.hint(far(first)))?;
    if at.scales.iter().any(|scale| (scale - 1.0).abs() > MOST_OFF) {
        let text =
            format!("lengths in {crs} are {:.3} times those on the ground at the cameras of `{path}`", at.scales[1]);
        return Err(StageError::new(text).hint(far(first)));
    }
    file.cameras.frame = Frame::World.at(Some(Georeference::world(crs.clone())));
    if let Some(covariance) = &mut file.covariance {
        covariance.frame = file.cameras.frame;
    }
    report(file, reference, (&crs, &at, map.has_figure_of_wgs_84()), params, context);
    Ok(())
}

/// The system that centres are brought to: with heights only where the way to them is given.
fn wanted(
    reference: &Stated,
    first: [f64; 3],
    params: &ImportCamerasParams,
    context: &Context,
) -> Result<Crs, StageError> {
    let path = &params.path.0;
    let own = Some(reference.clone()).filter(|_| params.crs.is_none());
    if own.as_ref().is_some_and(|own| own.kind != Kind::Projected) {
        let text = format!(
            "the chunk of `{path}` is referenced to `{}`, so its centres are geocentric (X, Y and Z from the centre of the Earth), which fit no model",
            reference.name
        );
        return Err(StageError::new(text).hint(format!(
            "say with `crs` in which system the model was exported, such as the UTM zone of the site, `crs: {}`: cameras are brought to it; or set the \
             chunk to a local system in metres in Metashape (Reference > Settings), and export model and cameras again",
            zone(first)
        )));
    }
    let settled = settle(path, [own, None], params.crs.as_ref(), (Tool::Other, None), context)?;
    let Some(crs) = settled.crs else {
        let text = format!("the system of the chunk of `{path}`, `{}`, cannot be carried on", reference.name);
        return Err(StageError::new(text).hint("say with `crs: EPSG:...` which one it is"));
    };
    let has_geoid = crs.has_heights() && crs.wkt().starts_with("COMP");
    if !has_geoid || params.offset_m[2].abs() > 0.0 {
        return Ok(crs);
    }
    if params.crs.is_some() {
        let text = format!(
            "heights in {crs} are not above the ellipsoid, as those of the chunk of `{path}` are, and no geoid is known here"
        );
        return Err(StageError::new(text).hint(format!(
            "give the system without heights, `crs: {}`; or, with heights, what brings those above the ellipsoid to them as the third number of \
             `offset_m` (minus the undulation of the geoid above the ellipsoid of {})",
            crs.horizontal().as_str(),
            crs.horizontal().as_str()
        )));
    }
    Ok(crs.horizontal())
}

/// The shift from WGS 84 to the datum of the system that is wanted, where there is one.
fn datum_shift(
    chunk: Option<Datum>,
    wanted: Option<Datum>,
    (path, crs): (&str, &Crs),
    context: &Context,
) -> Result<Option<DatumShift>, StageError> {
    let (Some(chunk), Some(wanted)) = (chunk, wanted) else {
        context.warn(format!("the datum of the chunk of `{path}` cannot be read: it is taken for that of {crs}"));
        return Ok(None);
    };
    if chunk.is(&wanted) {
        return Ok(None);
    }
    let names = format!("the chunk of `{path}` is on the datum {}, {crs} on {}", chunk.name, wanted.name);
    if chunk.is_near(&wanted) {
        context.warn(format!("{names}: they are taken for the same, and are a metre or two apart at most"));
        return Ok(None);
    }
    match DatumShift::of(crs).filter(|_| is_like_wgs_84(&chunk.name)) {
        Some(shift) => {
            context.warn(format!(
                "{names}: centres are shifted by the numbers that go with the code, which is exact for CH1903+ and good to some metres for other datums; a model that \
                 was exported with a grid of shifts differs by that"
            ));
            Ok(Some(shift))
        }
        None => Err(StageError::new(format!("{names}: the shift from one to the other is not known here")).hint(
            "set the chunk to that system in Metashape (Reference > Convert), and export model and cameras again",
        )),
    }
}

/// The UTM zone of a place (WGS 84), as `crs` takes it.
fn zone(geocentric_m: [f64; 3]) -> String {
    format!("EPSG:{}", utm_zone(place_deg(geocentric_m)))
}

fn far(first: [f64; 3]) -> String {
    let [longitude, latitude] = place_deg(first);
    format!("the site is at longitude {longitude:.4}, latitude {latitude:.4}: its UTM zone is {}", zone(first))
}

fn report(
    file: &CameraFile,
    reference: &Stated,
    (crs, at, is_modern): (&Crs, &AtBlock, bool),
    params: &ImportCamerasParams,
    context: &Context,
) {
    let side = if at.convergence_deg < 0.0 { "west" } else { "east" };
    context.note(format!(
        "{} centres brought from geocentric coordinates of the chunk (`{}`) to {crs}, with heights above the ellipsoid; rotations turned along, grid north \
         being {:.4} degrees to the {side} of true north",
        file.cameras.images.len(),
        reference.name,
        at.convergence_deg.abs()
    ));
    if params.offset_m[2].abs() <= 0.0 {
        let path = &params.path.0;
        let fit = format!("they fit a model exported in {crs} without a geoid");
        context.warn(if is_modern {
            format!(
                "heights of the centres of `{path}` are above the ellipsoid, as Metashape has them: {fit}; one with heights above the sea is some tens of metres off, \
                 unless minus the undulation of the geoid is the third number of `offset_m`"
            )
        } else {
            // The older ellipsoids were laid along the sea of their countries.
            format!(
                "heights of the centres of `{path}` are above the ellipsoid of {crs}, not that of WGS 84: {fit}; heights above the sea are often within some metres of \
                 them, and the third number of `offset_m` brings one to the other (minus the undulation of the geoid above that ellipsoid)"
            )
        });
    }
    let [least, greatest] = at.scales;
    let worst = if (least - 1.0).abs() > (greatest - 1.0).abs() { least } else { greatest };
    context.metric("map_scale_minus_1", worst - 1.0, "1");
    context.metric("map_scale_error", at.most_px, "px");
    let text = format!(
        "horizontal lengths in {crs} are {worst:.6} times those at the height of the cameras (scale - 1: {:.1e} to {:.1e} over the block), and heights are not scaled: \
         what is projected falls up to {:.2} px from where the photographs have it, at any distance; lengths are up to {:.1} mm in 10 m off",
        least - 1.0,
        greatest - 1.0,
        at.most_px,
        1e4 * (worst - 1.0).abs()
    );
    if at.most_px > NOTABLE_PX {
        context.warn(format!("{text}; a local system in metres has no such scale"));
    } else {
        context.note(text);
    }
}

#[cfg(test)]
mod tests;
