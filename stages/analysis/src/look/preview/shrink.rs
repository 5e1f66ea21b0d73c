//! A finished picture at the size of a preview.

use rockface_core::artefact::Preview;

use super::WIDTH_PX;

/// Pixels a picture may have to be looked at.
const MOST: usize = 100_000_000;

/// Means of whole blocks of pixels; `None` for a file that is no picture of 8 bits a channel.
pub(super) fn png(file: &[u8]) -> Option<Preview> {
    let mut decoder = png::Decoder::new(std::io::Cursor::new(file));
    decoder.set_transformations(png::Transformations::normalize_to_color8());
    let mut reader = decoder.read_info().ok()?;
    let size = reader.output_buffer_size().filter(|size| *size <= 4 * MOST)?;
    let mut pixels = vec![0; size];
    let info = reader.next_frame(&mut pixels).ok()?;
    let channels = info.color_type.samples();
    let (width, height) = (info.width as usize, info.height as usize);
    let step = width.div_ceil(WIDTH_PX).max(1);
    let (across, down) = ((width / step).max(1), (height / step).max(1));
    let mut rgb = Vec::with_capacity(3 * across * down);
    for place in 0..across * down {
        let (left, top) = (place % across * step, place / across * step);
        let block = || {
            (top..(top + step).min(height))
                .flat_map(move |y| (left..(left + step).min(width)).map(move |x| y * width + x))
        };
        let count = block().count() as u32;
        let mean =
            |channel: usize| block().map(|pixel| u32::from(pixels[pixel * channels + channel])).sum::<u32>() / count;
        rgb.extend([0, 1, 2].map(|colour| mean(if channels < 3 { 0 } else { colour }) as u8));
    }
    Some(Preview { caption: "Picture".to_owned(), width: across, height: down, rgb })
}
