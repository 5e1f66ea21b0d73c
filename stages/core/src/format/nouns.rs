//! The file format of every artefact that is not plain JSON.

use crate::artefact::{
    Artefact, Cell, Cloud, CodecError, Depth, Export, Files, Inventory, Kind, Mesh, Meshes, Noise, Noun, Part, Polygon,
    Raster, Surface,
};

impl Noun for Cloud {
    const KIND: Kind = Kind::Cloud;
    fn of(artefact: &Artefact) -> Option<&Self> {
        if let Artefact::Cloud(value) = artefact { Some(value) } else { None }
    }
    fn encode(&self) -> Result<Vec<u8>, CodecError> {
        crate::format::ply::cloud::write(self)
    }
    fn decode(bytes: &[u8]) -> Result<Self, CodecError> {
        crate::format::ply::cloud::read(bytes)
    }
    fn memory_bytes(&self) -> usize {
        let point = 24 + 12 * usize::from(!self.normals.is_empty()) + 3 * usize::from(!self.colours.is_empty());
        self.points.len() * (point + 4 * (self.numbers.len() + self.values.len()))
    }
    fn has_exports() -> bool {
        true
    }
    fn exports(&self, stem: &str) -> Result<Vec<Export>, CodecError> {
        if self.points.is_empty() {
            return Ok(Vec::new());
        }
        Ok(vec![Export { path: format!("{stem}.laz"), bytes: super::cloud_laz::write(self)? }])
    }
}

impl Noun for Depth {
    const KIND: Kind = Kind::Depth;
    fn of(artefact: &Artefact) -> Option<&Self> {
        if let Artefact::Depth(value) = artefact { Some(value) } else { None }
    }
    fn encode(&self) -> Result<Vec<u8>, CodecError> {
        super::depth_exr::write(self)
    }
    fn decode(bytes: &[u8]) -> Result<Self, CodecError> {
        super::depth_exr::read(bytes)
    }
    fn memory_bytes(&self) -> usize {
        (1 + self.channels.len()) * self.z.len() * 4
    }
}

impl Noun for Files {
    const KIND: Kind = Kind::Files;
    fn of(artefact: &Artefact) -> Option<&Self> {
        if let Artefact::Files(value) = artefact { Some(value) } else { None }
    }
    fn encode(&self) -> Result<Vec<u8>, CodecError> {
        super::tar_file::write(&self.files)
    }
    fn decode(bytes: &[u8]) -> Result<Self, CodecError> {
        super::tar_file::read(bytes).map(|files| Self { files })
    }
    fn memory_bytes(&self) -> usize {
        self.files.iter().map(|(name, bytes)| name.len() + bytes.len()).sum()
    }
    fn has_exports() -> bool {
        true
    }
    fn exports(&self, stem: &str) -> Result<Vec<Export>, CodecError> {
        let export =
            |(name, bytes): &(String, Vec<u8>)| Export { path: format!("{stem}/{name}"), bytes: bytes.clone() };
        Ok(self.files.iter().map(export).collect())
    }
}

impl Noun for Inventory {
    const KIND: Kind = Kind::Inventory;
    fn of(artefact: &Artefact) -> Option<&Self> {
        if let Artefact::Inventory(value) = artefact { Some(value) } else { None }
    }
    fn encode(&self) -> Result<Vec<u8>, CodecError> {
        super::inventory_file::write(self)
    }
    fn decode(bytes: &[u8]) -> Result<Self, CodecError> {
        super::inventory_file::read(bytes)
    }
    fn memory_bytes(&self) -> usize {
        let ring = |ring: &Vec<[f64; 2]>| ring.len() * 16;
        let polygon = |polygon: &Polygon| ring(&polygon.exterior) + polygon.holes.iter().map(ring).sum::<usize>();
        let outlines: usize = self.features.iter().flat_map(|feature| &feature.outline).map(polygon).sum();
        outlines + self.features.len() * self.columns.len() * size_of::<Cell>()
    }
    fn has_exports() -> bool {
        true
    }
    fn exports(&self, stem: &str) -> Result<Vec<Export>, CodecError> {
        let table = self.table();
        let csv = Export { path: format!("{stem}.csv"), bytes: table.to_csv()? };
        #[cfg(feature = "parquet")]
        let parquet = [Export { path: format!("{stem}.parquet"), bytes: super::parquet_file::write(&table)? }];
        #[cfg(not(feature = "parquet"))]
        let parquet = [];
        Ok([csv].into_iter().chain(parquet).collect())
    }
}

impl Noun for Mesh {
    const KIND: Kind = Kind::Mesh;
    fn of(artefact: &Artefact) -> Option<&Self> {
        if let Artefact::Mesh(value) = artefact { Some(value) } else { None }
    }
    fn encode(&self) -> Result<Vec<u8>, CodecError> {
        Ok(super::ply::write_mesh(self))
    }
    fn decode(bytes: &[u8]) -> Result<Self, CodecError> {
        super::ply::read_mesh(bytes)
    }
    fn memory_bytes(&self) -> usize {
        self.vertices.len() * 24 + self.triangles.len() * 12 + self.colours.len() * 3
    }
}

impl Noun for Meshes {
    const KIND: Kind = Kind::Meshes;
    fn of(artefact: &Artefact) -> Option<&Self> {
        if let Artefact::Meshes(value) = artefact { Some(value) } else { None }
    }
    fn encode(&self) -> Result<Vec<u8>, CodecError> {
        crate::format::ply::parts::write(self)
    }
    fn decode(bytes: &[u8]) -> Result<Self, CodecError> {
        crate::format::ply::parts::read(bytes)
    }
    fn memory_bytes(&self) -> usize {
        let part = |part: &Part| part.vertices.len() * 24 + part.triangles.len() * 12 + part.name.len();
        self.parts.iter().map(part).sum()
    }
    fn items(&self) -> Option<Vec<String>> {
        Some(self.parts.iter().map(|part| part.name.clone()).collect())
    }
    fn has_exports() -> bool {
        true
    }
    fn exports(&self, stem: &str) -> Result<Vec<Export>, CodecError> {
        let names = crate::artefact::part_file_names(&self.parts);
        let export = |(part, name): (&Part, String)| Export {
            path: format!("{stem}/{name}.ply"),
            bytes: super::ply::write_mesh(&self.mesh(part)),
        };
        Ok(self.parts.iter().zip(names).map(export).collect())
    }
}

impl Noun for Noise {
    const KIND: Kind = Kind::Noise;
    fn of(artefact: &Artefact) -> Option<&Self> {
        if let Artefact::Noise(value) = artefact { Some(value) } else { None }
    }
    fn encode(&self) -> Result<Vec<u8>, CodecError> {
        super::noise_file::write(self)
    }
    fn decode(bytes: &[u8]) -> Result<Self, CodecError> {
        super::noise_file::read(bytes)
    }
    fn memory_bytes(&self) -> usize {
        self.grid.cells() * (8 + 5 * self.fields.len())
    }
}

impl Noun for Raster {
    const KIND: Kind = Kind::Raster;
    fn of(artefact: &Artefact) -> Option<&Self> {
        if let Artefact::Raster(value) = artefact { Some(value) } else { None }
    }
    fn encode(&self) -> Result<Vec<u8>, CodecError> {
        super::geotiff::write(self)
    }
    fn decode(bytes: &[u8]) -> Result<Self, CodecError> {
        super::geotiff::read(bytes)
    }
    fn memory_bytes(&self) -> usize {
        self.bands.len() * self.grid.cells() * 4
    }
    fn items(&self) -> Option<Vec<String>> {
        Some(self.bands.iter().map(|band| band.name.clone()).collect())
    }
}

impl Noun for Surface {
    const KIND: Kind = Kind::Surface;
    fn of(artefact: &Artefact) -> Option<&Self> {
        if let Artefact::Surface(value) = artefact { Some(value) } else { None }
    }
    fn encode(&self) -> Result<Vec<u8>, CodecError> {
        super::surface_file::write(self)
    }
    fn stream(&self, take: &mut dyn FnMut(&[u8])) -> Result<(), CodecError> {
        super::surface_file::stream(self, take)
    }
    fn decode(bytes: &[u8]) -> Result<Self, CodecError> {
        super::surface_file::read(bytes)
    }
    fn memory_bytes(&self) -> usize {
        self.points.len() * 12 + self.squares.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artefact::Frame;

    fn part(name: &str) -> Part {
        let vertices = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        Part { name: name.into(), class: "slab".into(), vertices, triangles: vec![[0, 1, 2]] }
    }

    #[test]
    fn exports_have_names_of_their_own_inside_the_folder() {
        let names = ["7", "../x", "a b", "A_b", "", "7"];
        let meshes = Meshes { frame: Frame::Wall, parts: names.into_iter().map(part).collect() };
        let exports = meshes.exports("pieces").unwrap();
        let paths: Vec<&str> = exports.iter().map(|export| export.path.as_str()).collect();
        let expected = ["7", "_.._x", "a_b", "A_b-3", "_", "7-5"].map(|name| format!("pieces/{name}.ply"));
        assert_eq!(paths, expected);
        let mesh = crate::format::ply::read_mesh(&exports[1].bytes).unwrap();
        assert_eq!(mesh, meshes.mesh(&meshes.parts[1]));
    }
}
