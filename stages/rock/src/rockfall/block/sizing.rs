//! The size of a block: sides of its box, a volume, or a form after Sneed and Folk.

use super::draw::Drawing;
use super::{BlockError, Solid};
use rockface_core::artefact::candidates::{AxisOrder, Exact, Size, SneedFolk, SneedFolkClass, Volume};
use rockface_core::numerics::portable_math;

/// Least S / L drawn for a class of forms: a block of no thickness is none.
const LEAST_FLATNESS: f64 = 0.05;

/// Gives a base shape its size; what comes back is the volume the finished block must be scaled to, if any.
pub fn apply(solid: &mut Solid, size: &Size, drawing: &mut Drawing) -> Result<Option<f64>, BlockError> {
    match size {
        Size::Axes(axes) => {
            let length = drawing.value("size.length_m", &axes.length_m)?;
            let height = axes.height_m.as_ref().map(|q| drawing.value("size.height_m", q)).transpose()?;
            let depth = axes.depth_m.as_ref().map(|q| drawing.value("size.depth_m", q)).transpose()?;
            stretch(solid, [length, height.unwrap_or(length), depth.unwrap_or(length)]);
            Ok(None)
        }
        Size::Volume(volume) => by_volume(solid, volume, drawing),
        Size::SneedFolk(form) => by_form(solid, form, drawing),
    }
}

/// Scales a solid about the origin so that it has a volume.
pub fn to_volume(solid: &mut Solid, volume_m3: f64) {
    let factor = portable_math::cbrt(volume_m3 / solid.volume());
    solid.map(|v| v.map(|x| x * factor));
}

/// Scales each axis so that the box has these sides.
fn stretch(solid: &mut Solid, sides_m: [f64; 3]) {
    let extent = solid.extent();
    solid.map(|v| std::array::from_fn(|i| v[i] * (sides_m[i] / extent[i])));
}

fn by_volume(solid: &mut Solid, volume: &Volume, drawing: &mut Drawing) -> Result<Option<f64>, BlockError> {
    let [length, height, depth] = solid.extent();
    let ratio = |q: &Option<_>, name: &str, own: f64, drawing: &mut Drawing| match q {
        Some(q) => drawing.value(name, q).map(|ratio| ratio * length),
        None => Ok(own),
    };
    let height = ratio(&volume.height_ratio, "size.height_ratio", height, drawing)?;
    let depth = ratio(&volume.depth_ratio, "size.depth_ratio", depth, drawing)?;
    stretch(solid, [length, height, depth]);
    let volume_m3 = drawing.value("size.volume_m3", &volume.volume_m3)?;
    to_volume(solid, volume_m3);
    Ok((volume.exact == Exact::Finished).then_some(volume_m3))
}

fn by_form(solid: &mut Solid, form: &SneedFolk, drawing: &mut Drawing) -> Result<Option<f64>, BlockError> {
    let (flatness, elongation) = match (form.class, &form.s_over_l, &form.elongation) {
        (Some(class), _, _) => in_class(class, drawing),
        (None, Some(flatness), Some(elongation)) => {
            (drawing.value("size.s_over_l", flatness)?, drawing.value("size.elongation", elongation)?)
        }
        _ => return Err(BlockError::Specification("a form needs a class or both of its ratios".into())),
    };
    drawing.note("size.intermediate_over_long", 1.0 - elongation * (1.0 - flatness));
    drawing.note("size.short_over_long", flatness);
    let sides = [1.0, 1.0 - elongation * (1.0 - flatness), flatness];
    stretch(solid, ordered(sides, form.order, drawing));
    match (&form.volume_m3, &form.long_m) {
        (Some(volume), None) => {
            let volume_m3 = drawing.value("size.volume_m3", volume)?;
            to_volume(solid, volume_m3);
            Ok((form.exact == Exact::Finished).then_some(volume_m3))
        }
        (None, Some(long)) => {
            let long_m = drawing.value("size.long_m", long)?;
            solid.map(|v| v.map(|x| x * long_m));
            Ok(None)
        }
        _ => Err(BlockError::Specification("a form needs either `volume_m3` or `long_m`".into())),
    }
}

/// S / L and (L - I) / (L - S), uniform over a class's field of the ternary diagram of Sneed and Folk (1958).
fn in_class(class: SneedFolkClass, drawing: &Drawing) -> (f64, f64) {
    use SneedFolkClass as Form;
    let (low, high) = match class {
        Form::C => (0.7, 1.0),
        Form::Cp | Form::Cb | Form::Ce => (0.5, 0.7),
        Form::P | Form::B | Form::E => (0.3, 0.5),
        Form::Vp | Form::Vb | Form::Ve => (LEAST_FLATNESS, 0.3),
    };
    let (left, right) = match class {
        Form::C => (0.0, 1.0),
        Form::Cp | Form::P | Form::Vp => (0.0, 0.33),
        Form::Cb | Form::B | Form::Vb => (0.33, 0.67),
        Form::Ce | Form::E | Form::Ve => (0.67, 1.0),
    };
    // The diagram is as wide as 1 - S / L at a height S / L.
    let area = |flatness: f64| (1.0 - flatness) * (1.0 - flatness);
    let flatness = 1.0 - (area(low) + drawing.uniform("size.form") * (area(high) - area(low))).sqrt();
    let elongation = left + drawing.uniform("size.elongation") * (right - left);
    (flatness.clamp(low, high), elongation)
}

/// Sides in the order of X, Y, Z.
fn ordered([long, middle, short]: [f64; 3], order: AxisOrder, drawing: &Drawing) -> [f64; 3] {
    use AxisOrder as Order;
    let all = [Order::Xyz, Order::Xzy, Order::Yxz, Order::Yzx, Order::Zxy, Order::Zyx];
    let order = match order {
        Order::Random => all[((drawing.uniform("size.order") * 6.0) as usize).min(5)],
        fixed => fixed,
    };
    match order {
        Order::Xyz | Order::Random => [long, middle, short],
        Order::Xzy => [long, short, middle],
        Order::Yxz => [middle, long, short],
        Order::Yzx => [short, long, middle],
        Order::Zxy => [middle, short, long],
        Order::Zyx => [short, middle, long],
    }
}
