//! An S3 server in this process, for tests: what object stores answer, and the ways in which they fail.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

/// How the server misbehaves.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Faults {
    /// One request in so many is answered with 500 or 503; 0 for none.
    pub fail_one_in: u64,
    /// How long every answer takes.
    pub delay: Duration,
    /// Bodies are cut in half, and the connection with them.
    pub truncate: bool,
    /// Bytes of blobs are changed.
    pub damage: bool,
    /// `If-None-Match` is ignored.
    pub ignore_conditions: bool,
    /// Every request is refused.
    pub forbid: bool,
    /// Requests that write are refused.
    pub forbid_writes: bool,
    /// Connections are closed without an answer.
    pub hang_up: bool,
    /// Requests are led on to the server at this port.
    pub lead_to: Option<u16>,
    /// Every page of a listing is the first one, and says that there are more.
    pub repeat: bool,
}

/// A bucket, and who answers for it.
pub struct Server {
    shared: Arc<Shared>,
    port: u16,
}

#[derive(Default)]
struct Shared {
    objects: Mutex<BTreeMap<String, Vec<u8>>>,
    faults: Mutex<Faults>,
    requests: AtomicU64,
}

struct Request {
    method: String,
    /// Without the bucket.
    key: String,
    query: BTreeMap<String, String>,
    is_conditional: bool,
    body: Vec<u8>,
}

impl Server {
    pub fn start() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let shared = Arc::new(Shared::default());
        let own = Arc::clone(&shared);
        // It ends with the process that tests.
        std::thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                let shared = Arc::clone(&own);
                std::thread::spawn(move || shared.serve(&stream));
            }
        });
        Self { shared, port }
    }

    /// What a client has in its environment.
    pub fn environment(&self) -> Vec<(&'static str, String)> {
        vec![
            ("AWS_ENDPOINT_URL", format!("http://127.0.0.1:{}", self.port)),
            ("AWS_ACCESS_KEY_ID", "test".to_owned()),
            ("AWS_SECRET_ACCESS_KEY", "test".to_owned()),
            ("AWS_REGION", "us-east-1".to_owned()),
            ("ROCKFACE_REMOTE_TIMEOUT", "6".to_owned()),
        ]
    }

    /// Where it listens.
    #[allow(dead_code)] // for the tests of the remote places alone
    pub fn port(&self) -> u16 {
        self.port
    }

    /// How many requests it has got.
    #[allow(dead_code)] // for the tests of the remote places alone
    pub fn requests(&self) -> u64 {
        self.shared.requests.load(Relaxed)
    }

    pub fn set(&self, faults: Faults) {
        *self.shared.faults.lock().unwrap() = faults;
    }

    /// The objects by name, to be changed as a fault would.
    pub fn objects(&self) -> MutexGuard<'_, BTreeMap<String, Vec<u8>>> {
        self.shared.objects.lock().unwrap()
    }
}

impl Shared {
    fn serve(&self, stream: &TcpStream) {
        let mut reader = BufReader::new(stream);
        while let Some(request) = read(&mut reader) {
            let number = self.requests.fetch_add(1, Relaxed);
            let faults = *self.faults.lock().unwrap();
            std::thread::sleep(faults.delay);
            if faults.hang_up {
                return;
            }
            let is_write = request.method != "GET" && request.method != "HEAD";
            let (status, body) = if faults.forbid || (faults.forbid_writes && is_write) {
                ("403 Forbidden", b"<Error><Code>AccessDenied</Code></Error>".to_vec())
            } else if faults.fail_one_in > 0 && number.is_multiple_of(faults.fail_one_in) {
                let status = if number.is_multiple_of(2) { "500 Internal Server Error" } else { "503 Slow Down" };
                (status, b"<Error><Code>InternalError</Code></Error>".to_vec())
            } else {
                self.answer(&request, faults)
            };
            let status = faults.lead_to.map_or(status, |_| "307 Temporary Redirect");
            if answer(stream, &request, status, &body, faults).is_none() {
                return;
            }
        }
    }

    fn answer(&self, request: &Request, faults: Faults) -> (&'static str, Vec<u8>) {
        let mut objects = self.objects.lock().unwrap();
        let key = &request.key;
        match request.method.as_str() {
            "GET" if request.query.contains_key("list-type") => ("200 OK", list(&objects, request, faults.repeat)),
            "GET" | "HEAD" => match objects.get(key) {
                Some(bytes) => {
                    let mut bytes = bytes.clone();
                    if faults.damage && (key.contains("/packs/") || key.contains("/blobs/")) {
                        bytes.iter_mut().for_each(|byte| *byte ^= 1);
                    }
                    ("200 OK", bytes)
                }
                None => ("404 Not Found", b"<Error><Code>NoSuchKey</Code></Error>".to_vec()),
            },
            "PUT" if request.is_conditional && !faults.ignore_conditions && objects.contains_key(key) => {
                ("412 Precondition Failed", b"<Error><Code>PreconditionFailed</Code></Error>".to_vec())
            }
            "PUT" => {
                objects.insert(key.clone(), request.body.clone());
                ("200 OK", Vec::new())
            }
            "DELETE" => {
                objects.remove(key);
                ("204 No Content", Vec::new())
            }
            _ => ("400 Bad Request", Vec::new()),
        }
    }
}

/// A page of a listing: at most 1000 objects, as S3 has it.
fn list(objects: &BTreeMap<String, Vec<u8>>, request: &Request, repeat: bool) -> Vec<u8> {
    let prefix = request.query.get("prefix").cloned().unwrap_or_default();
    let after = request.query.get("continuation-token").cloned().filter(|_| !repeat).unwrap_or_default();
    let mut found: Vec<_> = objects.iter().filter(|(key, _)| key.starts_with(&prefix) && **key > after).collect();
    let is_cut = found.len() > 1000 || repeat;
    found.truncate(1000);
    let entries: String = found
        .iter()
        .map(|(key, bytes)| {
            format!(
                "<Contents><Key>{key}</Key><LastModified>2026-01-01T00:00:00.000Z</LastModified><ETag>\"1\"</ETag><Size>{}</Size></Contents>",
                bytes.len()
            )
        })
        .collect();
    let next =
        found.last().filter(|_| is_cut).map(|(key, _)| format!("<NextContinuationToken>{key}</NextContinuationToken>"));
    format!(
        "<ListBucketResult><IsTruncated>{is_cut}</IsTruncated>{}{entries}</ListBucketResult>",
        next.unwrap_or_default()
    )
    .into_bytes()
}

/// `None` at the end of the connection.
fn read(reader: &mut BufReader<&TcpStream>) -> Option<Request> {
    let mut line = String::new();
    reader.read_line(&mut line).ok().filter(|count| *count > 0)?;
    let mut words = line.split(' ');
    let (method, target) = (words.next()?.to_owned(), words.next()?.to_owned());
    let (path, query) = target.split_once('?').unwrap_or((&target, ""));
    let (mut length, mut is_conditional) = (0, false);
    loop {
        let mut line = String::new();
        reader.read_line(&mut line).ok()?;
        let Some((name, value)) = line.trim_end().split_once(':') else { break };
        match name.to_ascii_lowercase().as_str() {
            "content-length" => length = value.trim().parse().ok()?,
            "if-none-match" => is_conditional = true,
            _ => {}
        }
    }
    let mut body = vec![0; length];
    reader.read_exact(&mut body).ok()?;
    let pair = |pair: &str| {
        let (name, value) = pair.split_once('=').unwrap_or((pair, ""));
        (name.to_owned(), value.replace("%2F", "/"))
    };
    let query = query.split('&').map(pair).collect();
    // The bucket is the first part of the path.
    let key = path.trim_start_matches('/').split_once('/').map_or("", |(_, key)| key).to_owned();
    Some(Request { method, key, query, is_conditional, body })
}

/// `None` where the connection is closed.
fn answer(mut stream: &TcpStream, request: &Request, status: &str, body: &[u8], faults: Faults) -> Option<()> {
    let length = body.len();
    let elsewhere = faults.lead_to.map(|port| format!("Location: http://127.0.0.1:{port}/bucket/other\r\n"));
    let elsewhere = elsewhere.unwrap_or_default();
    let head = format!(
        "HTTP/1.1 {status}\r\n{elsewhere}Content-Length: {length}\r\nETag: \"1\"\r\nLast-Modified: Thu, 01 Jan 2026 00:00:00 GMT\r\n\r\n"
    );
    stream.write_all(head.as_bytes()).ok()?;
    if request.method == "HEAD" {
        return Some(());
    }
    if faults.truncate && length > 1 && request.method == "GET" {
        stream.write_all(&body[..length / 2]).ok()?;
        let _ = stream.shutdown(std::net::Shutdown::Both);
        return None;
    }
    stream.write_all(body).ok()
}
