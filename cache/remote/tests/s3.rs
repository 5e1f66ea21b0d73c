//! S3 as a place for results: the one suite, against a server in this process, and the faults of servers.

#[path = "../../tests/remote/suite.rs"]
mod suite;

#[path = "../../../tests/house/s3.rs"]
mod server;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::Duration;

use rockface_cache::Digest;
use rockface_cache::remote::{Backend, Use};
use server::{Faults, Server};
use suite::{fill, large, over, remote, small};

fn handle(server: &Server, prefix: &str) -> Box<dyn Backend> {
    let variables = server.environment().into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
    rockface_remote::open_with(&format!("s3://bucket/{prefix}"), &variables).unwrap()
}

fn nobody_stops() -> AtomicBool {
    AtomicBool::new(false)
}

/// A server with the outputs of eight steps.
fn filled() -> (Server, Vec<Digest>) {
    let server = Server::start();
    let (_folder, maker) = over(&|| handle(&server, "p"));
    let keys = fill(&maker, 0..8);
    assert_eq!(maker.finish_uploads(&nobody_stops()).records, 8);
    (server, keys)
}

#[test]
fn s3_is_a_place_for_results() {
    let server = Arc::new(Server::start());
    let count = AtomicU32::new(0);
    suite::run(&|| {
        let (server, prefix) = (Arc::clone(&server), format!("p{}/q", count.fetch_add(1, Ordering::Relaxed)));
        Box::new(move || handle(&server, &prefix))
    });
}

#[test]
fn a_page_of_a_listing_is_not_all_of_it() {
    let server = Server::start();
    server.objects().extend((0..2500).map(|number| (format!("p/many/{number:04}"), b"x".to_vec())));
    assert_eq!(handle(&server, "p").list("many/").unwrap().len(), 2500);
}

#[test]
fn a_listing_that_does_not_end_is_given_up() {
    let server = Server::start();
    server.objects().extend((0..3).map(|number| (format!("p/many/{number}"), b"x".to_vec())));
    server.set(Faults { repeat: true, ..Faults::default() });
    let fault = handle(&server, "p").list("many/").unwrap_err().to_string();
    assert!(fault.contains("does not end: it names `p/many/0` again"), "{fault}");
    assert!(server.requests() < 4, "{}", server.requests());
}

#[test]
fn a_server_leads_nobody_to_another_one() {
    let (server, other) = (Server::start(), Server::start());
    other.objects().insert("other".to_owned(), b"elsewhere".to_vec());
    server.objects().insert("p/blob".to_owned(), b"here".to_vec());
    let place = handle(&server, "p");
    assert_eq!(place.get("blob", 100).unwrap(), b"here");
    server.set(Faults { lead_to: Some(other.port()), ..Faults::default() });
    let fault = place.get("blob", 100).unwrap_err().to_string();
    assert!(fault.contains("307"), "{fault}");
    assert!(place.list("").is_err() && place.put("new", b"bytes").is_err());
    assert_eq!(other.requests(), 0);
}

#[test]
fn a_bucket_without_a_prefix_is_a_place_too() {
    let server = Server::start();
    suite::moves_bytes(&|| handle(&server, ""));
}

#[test]
fn whatever_a_server_does_no_byte_is_wrong_and_nothing_hangs() {
    let slow = Faults { delay: Duration::from_millis(300), ..Faults::default() };
    for (faults, is_hit) in [
        (slow, true),
        (Faults { fail_one_in: 3, ..Faults::default() }, true),
        (Faults { truncate: true, ..Faults::default() }, false),
        (Faults { damage: true, ..Faults::default() }, false),
        (Faults { hang_up: true, ..Faults::default() }, false),
        (Faults { delay: Duration::from_mins(1), ..Faults::default() }, false),
    ] {
        let (server, keys) = filled();
        server.set(faults);
        let (_folder, user) = over(&|| handle(&server, "p"));
        for number in 0..8 {
            let bytes = if number % 2 == 0 { small(number) } else { large(number) };
            let got = user.get(&Digest::of(&bytes)).ok();
            assert!(got.is_none_or(|got| got == bytes), "{faults:?}");
            assert_eq!(user.hit_outcome(&keys[number as usize]).is_some(), is_hit, "{faults:?}");
        }
        // Work goes on, and ends.
        assert_eq!(fill(&user, 0..9)[..8], keys);
        user.finish_uploads(&nobody_stops());
    }
}

#[test]
fn a_server_that_ignores_conditions_is_found_out() {
    let server = Server::start();
    let honours = || remote(&|| handle(&server, "p"), Use::Itself).unwrap().honours_create().unwrap();
    assert!(honours());
    server.set(Faults { ignore_conditions: true, ..Faults::default() });
    assert!(!honours());
    assert!(server.objects().keys().all(|key| !key.contains("probe")), "nothing is left over");
}

#[test]
fn a_server_that_forbids_is_an_error_that_says_so() {
    let (server, _) = filled();
    server.set(Faults { forbid: true, ..Faults::default() });
    let fault = remote(&|| handle(&server, "p"), Use::Layer).unwrap_err().to_string();
    assert!(
        fault.contains("forbidden") && fault.contains("s3://bucket/p") && fault.contains("AWS_ACCESS_KEY_ID"),
        "{fault}"
    );
    // A new place cannot be made where nothing may be written.
    server.set(Faults { forbid_writes: true, ..Faults::default() });
    let fault = remote(&|| handle(&server, "new"), Use::Layer).unwrap_err().to_string();
    assert!(fault.contains("forbidden") && fault.contains("--remote-read-only"), "{fault}");
    assert!(remote(&|| handle(&server, "p"), Use::ReadOnlyLayer).unwrap().keys().len() == 8);
}

#[test]
fn addresses_that_name_no_place_are_refused_in_words() {
    for (text, word) in [("ftp://host/x", "no remote place"), ("nonsense", "no URL"), ("s3://", "s3://")] {
        let fault = rockface_remote::open_with(text, &rockface_remote::Variables::new()).unwrap_err();
        assert!(fault.contains(word), "{text}: {fault}");
    }
}

#[test]
fn what_is_never_sent_is_refused_and_passwords_are_not_shown() {
    let open = |text: &str| rockface_remote::open_with(text, &rockface_remote::Variables::new());
    for (text, place, way) in [
        ("http://alice:S3cret@127.0.0.1:9/a", "http://127.0.0.1:9/a: user and password", "s3://BUCKET/PREFIX"),
        ("https://S3cret@host/a", "https://host/a: user and password", "can be read without"),
        ("https://host/a?sig=S3cret", "https://host/a?…: what begins with `?`", "can be read without"),
        ("https://host/a#S3cret", "https://host/a#…", "what begins with `#`"),
        ("s3://key:S3cret@bucket/p", "s3://bucket/p", "AWS_ACCESS_KEY_ID"),
        ("https://a.blob.core.windows.net/c/p?sig=S3cret", "/c/p?…", "AZURE_STORAGE_SAS_TOKEN"),
        ("abfss://c:S3cret@a.dfs.core.windows.net/", "abfss://a.dfs.core.windows.net/", "AZURE_STORAGE_ACCOUNT_KEY"),
        ("gs://bucket/p?key=S3cret", "gs://bucket/p?…", "GOOGLE_SERVICE_ACCOUNT"),
        ("http://alice:S3cret/x@host/a", "`http://…@host/a` is no URL", "port"),
        ("ftp://alice:S3cret@host/a", "`ftp://…@host/a` is no remote place", "s3://BUCKET/PREFIX"),
    ] {
        let fault = open(text).unwrap_err();
        assert!(fault.contains(place) && fault.contains(way) && !fault.contains("S3cret"), "{text}: {fault}");
    }
    assert_eq!(open("https://host/a").unwrap().url(), "https://host/a");
    // An endpoint comes from the environment, and the error names it.
    let endpoint = "http://alice:S3cret@127.0.0.1:1/x?sig=S3cret";
    let variables = [("AWS_ENDPOINT_URL", endpoint), ("AWS_ACCESS_KEY_ID", "a"), ("AWS_SECRET_ACCESS_KEY", "b")];
    let variables = variables.into_iter().chain([("AWS_REGION", "eu-central-1"), ("ROCKFACE_REMOTE_TIMEOUT", "1")]);
    let variables = variables.map(|(name, value)| (name.to_owned(), value.to_owned())).collect();
    let place = rockface_remote::open_with("s3://bucket/p", &variables).unwrap();
    let fault = format!("{:?}", place.get("a", 9).unwrap_err());
    assert!(!fault.contains("S3cret"), "{fault}");
}
