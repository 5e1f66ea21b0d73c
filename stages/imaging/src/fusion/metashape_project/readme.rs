//! The README.txt of the folder.

use rockface_core::artefact::Frame;

/// The text of README.txt.
pub fn text(maps: usize, frame: Frame, origin_m: [f64; 3]) -> String {
    let [x, y, z] = origin_m;
    let offset =
        if origin_m.iter().all(|x| *x == 0.0) { String::new() } else { format!(", offset_m: [{x}, {y}, {z}]") };
    format!(
        "{maps} depth maps for Agisoft Metashape Professional 2.0 or later

depth/*.tif       float32, one channel: z along the optical axis in metres, 0 where there is none;
                  without lens distortion, the principal point as in cameras.xml
images/*.png      the surface lit from the camera; Metashape wants a picture with every depth map
cameras.xml       cameras of these maps for Metashape: one sensor without distortion, orientation in metres
images.json       which file is which image
import_depth.py   imports all of it, builds a mesh from the depth maps and writes it as PLY

1. metashape.sh -r import_depth.py fused.ply      (Windows: metashape.exe -r import_depth.py fused.ply)

   It stops with a message where Metashape did not take a picture, an orientation or a calibration. By hand: File >
   Import > Import Depth Images, File > Import > Import Cameras (cameras.xml), Workflow > Build Model from depth maps,
   File > Export > Export Model in local coordinates.

2. Take the mesh back, and go on with it as with any other:

   fused: {{stage: import-mesh, with: {{path: fused.ply, frame: {frame}{offset}, defects: keep}}}}

   Coordinates are metres in the {frame} frame{counted}. A mesh in the world frame goes to the wall by
   transform-crs with the `transform` of the first epoch.

The script was checked against the calls of Metashape's documented Python interface, not against Metashape itself.
",
        counted = if offset.is_empty() { String::new() } else { format!(", counted from ({x}, {y}, {z})") }
    )
}
