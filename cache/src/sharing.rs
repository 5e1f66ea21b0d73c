//! Who may use what is new in a store: whom its root folder lets in, whatever the umask of the process that makes it.
//!
//! Files get the `rw` bits of the root for group and others, folders its `rwx` bits and its setgid bit. What cannot be given to the group
//! of the root folder lets its own group do no more than all others, so nothing is open to anybody whom the root folder keeps out. With an
//! access control list the bits of the group are those of its mask, which are taken over. What root makes belongs to the owner of the root folder.

use std::fs::{self, DirBuilder, File, OpenOptions, Permissions};
use std::io::{self, ErrorKind};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, PermissionsExt, fchown};
use std::path::Path;

use rustix::fs::{OFlags, fgetxattr};
use rustix::process::{getegid, geteuid};

use crate::plain;

/// What files may let anybody do.
pub(crate) const FILE: u32 = 0o666;
/// What folders may let anybody do.
const FOLDER: u32 = 0o777;
/// What is new in a folder belongs to the group of the folder.
const SETGID: u32 = 0o2000;
/// Starts the names of folders that have not got their mode yet.
pub(crate) const NEW: &str = ".new-";
/// The attribute of files that have an access control list.
const ACL: &str = "system.posix_acl_access";

/// Whose the root folder of a store is, and what it lets its group and all others do.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sharing {
    mode: u32,
    owner: u32,
    group: u32,
}

impl Sharing {
    /// That of the store, or of the folder in one, at `root`. One that cannot be looked at shares nothing.
    pub fn of(root: &Path) -> Self {
        let own = Self { mode: 0o700, owner: geteuid().as_raw(), group: getegid().as_raw() };
        fs::metadata(root).map_or(own, |meta| Self { mode: meta.mode(), owner: meta.uid(), group: meta.gid() })
    }

    fn others(self) -> u32 {
        self.mode & 0o007
    }

    /// The mode of something in the store that lets nobody do more than `most`, and whose group, or mask, `is_same` as that of the root.
    fn mode(self, most: u32, is_same: bool) -> u32 {
        let of_group = if is_same { self.mode & 0o070 } else { self.others() << 3 };
        most & (0o700 | of_group | self.others())
    }

    /// The mode to make something with, before its group is known: never more than it will have.
    pub fn first(self, most: u32) -> u32 {
        most & (0o700 | (self.mode & 0o070 & (self.others() << 3)) | self.others())
    }

    /// [`Sharing::first`] for a builder of temporary files.
    pub fn permissions(self) -> Permissions {
        Permissions::from_mode(self.first(FILE))
    }

    /// Whether others than its owner may make something in the store.
    fn is_of_several(self) -> bool {
        self.mode & 0o022 != 0
    }

    /// Gives a file that this process has made its owner, its group and its mode, `most` at most. File systems that know none of them leave
    /// it as it is.
    pub fn give(self, file: &File, most: u32) -> io::Result<()> {
        let meta = file.metadata()?;
        // What root makes in a private store would keep its owner out. A file with other names may be one from elsewhere.
        let is_new = meta.uid() == geteuid().as_raw() && (meta.is_dir() || meta.nlink() <= 1);
        if geteuid().is_root() && is_new && self.owner != meta.uid() {
            let _ = fchown(file, Some(self.owner), None);
        }
        let mut group = meta.gid();
        let matters = self.mode & 0o070 != self.others() << 3;
        if group != self.group && matters && fchown(file, None, Some(self.group)).is_ok() {
            group = self.group;
        }
        let setgid = if meta.is_dir() && group == self.group { self.mode & SETGID } else { 0 };
        let mode = self.mode(most, group == self.group || has_acl(file)) | setgid;
        if meta.mode() & 0o7777 == mode {
            return Ok(());
        }
        match file.set_permissions(Permissions::from_mode(mode)) {
            Err(fault) if matches!(fault.kind(), ErrorKind::PermissionDenied | ErrorKind::Unsupported) => Ok(()),
            given => given,
        }
    }

    /// Makes a folder where there is nothing.
    pub fn new_folder(self, path: &Path) -> io::Result<()> {
        DirBuilder::new().mode(self.first(FOLDER)).create(path).and_then(|()| self.give_folder(path))
    }

    fn give_folder(self, path: &Path) -> io::Result<()> {
        let flags = OFlags::NOFOLLOW | OFlags::DIRECTORY;
        let folder = OpenOptions::new().read(true).custom_flags(flags.bits() as i32).open(path)?;
        self.give(&folder, FOLDER)
    }

    /// Makes a folder unless there is one. Where others may use it at once, it has its mode before it has its name.
    pub fn folder(self, path: &Path) -> io::Result<()> {
        let made = if self.is_of_several() && !plain::is_folder(path) {
            self.folder_in_place(path)
        } else {
            self.new_folder(path)
        };
        made.or_else(|fault| if plain::is_folder(path) { Ok(()) } else { Err(fault) })
    }

    fn folder_in_place(self, path: &Path) -> io::Result<()> {
        if !plain::is_absent(path) {
            return Err(ErrorKind::AlreadyExists.into());
        }
        let around = path.parent().unwrap_or(Path::new("."));
        let mut builder = tempfile::Builder::new();
        let new = builder.prefix(NEW).permissions(Permissions::from_mode(self.first(FOLDER))).tempdir_in(around)?;
        self.give_folder(new.path())?;
        // An empty folder that another process has made meanwhile is replaced, any other is left.
        fs::rename(new.path(), path)?;
        let _ = new.keep();
        Ok(())
    }

    /// Opens a file to read and to write, making it if there is none.
    pub fn open_or_make(self, path: &Path) -> io::Result<File> {
        let open = |options: &mut OpenOptions| plain::open_with(options.read(true).write(true), path);
        match plain::settled(|| open(&mut OpenOptions::new())) {
            Err(fault) if fault.kind() == ErrorKind::NotFound => {}
            opened => return opened,
        }
        match open(OpenOptions::new().create_new(true).mode(self.first(FILE))) {
            Ok(file) => self.give(&file, FILE).map(|()| file),
            // Another process was first.
            Err(fault) if fault.kind() == ErrorKind::AlreadyExists => plain::settled(|| open(&mut OpenOptions::new())),
            fault => fault,
        }
    }
}

/// Whether the bits of a file's group are those of the mask of an access control list.
fn has_acl(file: &File) -> bool {
    let mut no_value: [u8; 0] = [];
    fgetxattr(file, ACL, &mut no_value).is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mode(path: &Path) -> u32 {
        fs::symlink_metadata(path).unwrap().mode() & 0o7777
    }

    #[test]
    fn files_and_folders_let_others_do_what_the_root_does() {
        for (root, file, blob, folder) in [
            (0o700, 0o600, 0o400, 0o700),
            (0o755, 0o644, 0o444, 0o755),
            (0o750, 0o640, 0o440, 0o750),
            (0o2770, 0o660, 0o440, 0o2770),
            (0o2775, 0o664, 0o444, 0o2775),
            (0o1777, 0o666, 0o444, 0o777),
        ] {
            let place = tempfile::tempdir().unwrap();
            fs::set_permissions(place.path(), Permissions::from_mode(root)).unwrap();
            let (sharing, at) = (Sharing::of(place.path()), |name: &str| place.path().join(name));
            sharing.folder(&at("folder")).unwrap();
            sharing.folder(&at("folder")).unwrap();
            let made = sharing.open_or_make(&at("file")).unwrap();
            assert_eq!((mode(&at("file")), mode(&at("folder"))), (file, folder), "{root:o}");
            sharing.give(&made, 0o444).unwrap();
            assert_eq!(mode(&at("file")), blob, "{root:o}");
            assert_eq!(fs::read_dir(place.path()).unwrap().count(), 2, "nothing else is left");
            // What was there keeps its mode: its owner decides.
            fs::set_permissions(at("folder"), Permissions::from_mode(0o711)).unwrap();
            sharing.folder(&at("folder")).unwrap();
            sharing
                .open_or_make(&at("file"))
                .map(drop)
                .or_else(|fault| if blob < 0o600 { Ok(()) } else { Err(fault) })
                .unwrap();
            assert_eq!((mode(&at("file")), mode(&at("folder"))), (blob, 0o711), "{root:o}");
        }
    }

    #[test]
    fn what_has_another_group_lets_it_do_what_all_others_may() {
        for (root, file) in [(0o2770, 0o600), (0o2775, 0o644), (0o777, 0o666)] {
            let sharing = Sharing { mode: root, owner: 7, group: 7 };
            assert_eq!(sharing.mode(FILE, false), file, "{root:o}");
            assert_eq!(sharing.first(FILE) & !sharing.mode(FILE, false), 0, "{root:o}");
            assert_eq!(sharing.first(FILE) & !sharing.mode(FILE, true), 0, "{root:o}");
        }
        assert_eq!(Sharing::of(Path::new("/nowhere/at/all")).first(FOLDER), 0o700);
    }

    #[test]
    fn what_root_makes_belongs_to_the_owner_of_the_store() {
        if !geteuid().is_root() {
            println!("skipped: only root can give files to others");
            return;
        }
        let place = tempfile::tempdir().unwrap();
        fs::set_permissions(place.path(), Permissions::from_mode(0o700)).unwrap();
        std::os::unix::fs::chown(place.path(), Some(1), Some(1)).unwrap();
        let sharing = Sharing::of(place.path());
        sharing.folder(&place.path().join("folder")).unwrap();
        let file = sharing.open_or_make(&place.path().join("file")).unwrap();
        let owner = |name: &str| fs::metadata(place.path().join(name)).unwrap().uid();
        assert_eq!((owner("file"), owner("folder"), mode(&place.path().join("file"))), (1, 1, 0o600));
        // One that has another name may be from elsewhere.
        std::os::unix::fs::chown(place.path().join("file"), Some(0), None).unwrap();
        fs::hard_link(place.path().join("file"), place.path().join("other")).unwrap();
        sharing.give(&file, FILE).unwrap();
        assert_eq!(owner("file"), 0);
    }

    #[test]
    fn the_mask_of_an_access_control_list_is_that_of_the_root() {
        let place = tempfile::tempdir().unwrap();
        fs::set_permissions(place.path(), Permissions::from_mode(0o700)).unwrap();
        // The owner and group 2000 may do all, the group and all others nothing.
        let entries: [(u16, u16, u32); 5] =
            [(1, 7, u32::MAX), (4, 0, u32::MAX), (8, 7, 2000), (16, 7, u32::MAX), (32, 0, u32::MAX)];
        let entry = |(tag, may, id): (u16, u16, u32)| {
            [&tag.to_le_bytes()[..], &may.to_le_bytes()[..], &id.to_le_bytes()[..]].concat()
        };
        let list = [2_u32.to_le_bytes().to_vec(), entries.into_iter().flat_map(entry).collect()].concat();
        for name in [ACL, "system.posix_acl_default"] {
            if let Err(fault) = rustix::fs::setxattr(place.path(), name, &list, rustix::fs::XattrFlags::empty()) {
                println!("skipped: this file system has no access control lists ({fault})");
                return;
            }
        }
        assert_eq!(mode(place.path()), 0o770);
        // A group that no file here has, nor can be given.
        let sharing = Sharing { group: u32::MAX - 1, ..Sharing::of(place.path()) };
        let file = File::create(place.path().join("file")).unwrap();
        assert!(has_acl(&file));
        file.set_permissions(Permissions::from_mode(0o600)).unwrap();
        sharing.give(&file, FILE).unwrap();
        assert_eq!(mode(&place.path().join("file")), 0o660);
        rustix::fs::fremovexattr(&file, ACL).unwrap();
        assert!(!has_acl(&file));
    }

    #[test]
    fn a_link_or_a_file_in_the_place_of_a_folder_is_none() {
        let place = tempfile::tempdir().unwrap();
        let at = |name: &str| place.path().join(name);
        fs::write(at("file"), "").unwrap();
        std::os::unix::fs::symlink(place.path(), at("link")).unwrap();
        for mode in [0o700, 0o770] {
            fs::set_permissions(place.path(), Permissions::from_mode(mode)).unwrap();
            for name in ["file", "link"] {
                let fault = Sharing::of(place.path()).folder(&at(name)).unwrap_err();
                assert_eq!(fault.kind(), ErrorKind::AlreadyExists, "{name}");
            }
        }
    }
}
