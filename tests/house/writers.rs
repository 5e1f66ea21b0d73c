//! Commands that write where the user says: what they replace, what they make, and what they leave out.

use std::fs;
use std::os::unix::fs::{FileTypeExt, symlink};

use rustix::fs::{CWD, FileType, mknodat};

use crate::cli::{House, SMALL};
use crate::folders::unpacked;

fn small() -> House {
    let house = House::new(SMALL);
    let (code, _, err) = house.rockface(&["run", "p.yaml"]);
    assert_eq!(code, Some(0), "{err}");
    house
}

#[test]
fn no_command_replaces_a_pipe_or_a_link() {
    let house = small();
    mknodat(CWD, house.path("pipe"), FileType::Fifo, 0o600.into(), 0).unwrap();
    symlink("p.yaml", house.path("link")).unwrap();
    symlink("nowhere", house.path("dangling")).unwrap();
    for place in ["pipe", "link", "dangling"] {
        for command in [
            &["export", "latest", "dem.raster", place][..],
            &["export", "latest", "dem.raster", place, "--force"],
            &["archive", "latest", "-o", place],
            &["report", "latest", "-o", place],
            &["runs", "compare", "latest", "latest", "--html", place],
            &["run", "p.yaml", "--trace", place],
        ] {
            let (code, _, err) = house.rockface(command);
            assert!(code == Some(2) && err.contains("only a regular file is replaced"), "{command:?}: {err}");
        }
    }
    let kind = |name: &str| fs::symlink_metadata(house.path(name)).unwrap().file_type();
    assert!(kind("pipe").is_fifo() && kind("link").is_symlink() && kind("dangling").is_symlink());
    assert!(!house.path("nowhere").exists());
    assert_eq!(fs::read_to_string(house.path("p.yaml")).unwrap(), SMALL);
    symlink("nowhere", house.path("dem.tif.provenance.json")).unwrap();
    let (code, _, err) = house.rockface(&["export", "latest", "dem.raster", "dem.tif"]);
    assert!(code == Some(2) && err.contains("dem.tif.provenance.json is a link"), "{err}");
}

#[test]
fn an_archive_and_a_comparison_replace_their_own_only_and_make_their_folder() {
    let house = small();
    for command in
        [&["archive", "latest", "-o", "new/a/x"][..], &["runs", "compare", "latest", "latest", "--html", "new/b/x"]]
    {
        let path = house.path(command.last().unwrap());
        for _ in 0..2 {
            let (code, _, err) = house.rockface(command);
            assert!(code == Some(0) && err.is_empty() && path.is_file(), "{err}");
        }
        fs::write(&path, "mine").unwrap();
        let (code, _, err) = house.rockface(command);
        assert!(code == Some(2) && err.contains("x is there and is no"), "{err}");
        assert_eq!(fs::read(&path).unwrap(), b"mine");
    }
    let (code, _, err) = house.rockface(&["report", "latest", "-o", "new/c/x.html"]);
    assert!(code == Some(0) && house.path("new/c/x.html").is_file(), "{err}");
    let (code, _, err) = house.rockface(&["report", "latest", "-o", "p.yaml/x.html"]);
    assert!(code == Some(3) && err.contains("p.yaml/x.html") && !err.contains(".tmp"), "{err}");
}

#[test]
fn an_archive_takes_from_the_store_what_the_run_folder_lacks_and_names_what_neither_has() {
    let house = House::new(SMALL);
    let archived = |run: &[&str]| {
        let (code, _, err) = house.rockface(run);
        assert_eq!(code, Some(0), "{err}");
        let (code, _, err) = house.rockface(&["archive", "latest", "--outputs", "-o", "a.tar"]);
        assert_eq!(code, Some(0), "{err}");
        (unpacked(&house.path("a.tar")), err)
    };
    let (laid_out, err) = archived(&["run", "p.yaml"]);
    assert_eq!(err, "");
    let (stored, err) = archived(&["run", "p.yaml", "--outputs", "none"]);
    assert_eq!(err, "");
    for file in ["outputs/face/mesh.ply", "outputs/dem/raster.tif"] {
        assert!(stored[file] == laid_out[file], "{file}");
    }
    fs::remove_dir_all(house.path(".rockface")).unwrap();
    fs::write(house.path("p.yaml"), SMALL.replace("synthesise-face,", "synthesise-face, keep: false,")).unwrap();
    let (partly, err) = archived(&["run", "p.yaml"]);
    assert!(err.contains("1 outputs of this run are not in the archive") && err.contains("face.mesh"), "{err}");
    assert!(partly.contains_key("outputs/dem/raster.tif") && !partly.contains_key("outputs/face/mesh.ply"));
}

#[test]
fn an_archive_of_a_failed_run_misses_no_record_that_there_never_was() {
    let yaml = "rockface: 1\nname: failing\nsteps:\n  a: {stage: command, with: {program: sh, version: any, \
        args: ['-c', 'false'], outputs: {f: {kind: file, extension: txt}}}}\n";
    let house = House::new(yaml);
    assert_eq!(house.rockface(&["run", "p.yaml"]).0, Some(1));
    let (code, _, err) = house.rockface(&["archive", "latest", "-o", "a.tar"]);
    assert!(code == Some(0) && err.is_empty(), "{err}");
}
