//! Object stores as remote places for results: S3 and what speaks its protocol, Google Cloud Storage, Azure, HTTP to read from.
//!
//! All that is asynchronous stays in this crate: one small runtime drives the requests, and each call blocks until its own is
//! answered. Credentials come from the environment, under the names that the tools of each provider use.

#![cfg_attr(not(test), warn(clippy::print_stdout, clippy::print_stderr, clippy::exit))]

mod address;
mod connection;

use std::collections::{BTreeMap, HashSet};
use std::hash::BuildHasher;
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use futures_util::StreamExt;
use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey};
use object_store::azure::MicrosoftAzureBuilder;
use object_store::gcp::GoogleCloudStorageBuilder;
use object_store::http::HttpBuilder;
use object_store::path::Path;
use object_store::{
    BackoffConfig, ClientOptions, Error, GetResult, ObjectStore, ObjectStoreExt, ObjectStoreScheme, PutMode,
    PutOptions, PutPayload, RetryConfig,
};
use rockface_cache::remote::{Backend, BackendError, Object};
use tokio::runtime::{Builder, Runtime};
use url::Url;

use connection::Direct;

/// The time a request may take, with all its repetitions, before anything is transferred, seconds; the variable of the
/// environment changes it.
pub const TIMEOUT_S: f64 = 20.0;
/// The environment variable that replaces [`TIMEOUT_S`].
pub const TIMEOUT_VARIABLE: &str = "ROCKFACE_REMOTE_TIMEOUT";
/// The least speed of a transfer, bytes a second: the time it may take beyond that of the request.
const LEAST_SPEED: u64 = 256 * 1024;
/// How often a request is repeated.
const RETRIES: usize = 4;
/// Objects that a listing may name.
const MOST_LISTED: usize = 1 << 22;

/// Variables of an environment by name.
pub type Variables = BTreeMap<String, String>;

/// An object store as a remote place.
#[derive(Debug)]
struct Objects {
    url: String,
    runtime: &'static Runtime,
    store: Arc<dyn ObjectStore>,
    /// What stands before the names.
    prefix: Path,
    /// It is only read, and cannot be listed.
    is_http: bool,
    timeout: Duration,
}

/// Opens the remote place that a URL names: `s3://bucket/prefix`, `gs://bucket/prefix`, `az://container/prefix`, or
/// `https://host/path` to read from. Nothing is sent yet.
///
/// # Errors
///
/// What is wrong with the URL or with the variables of the environment, in words.
pub fn open(text: &str) -> Result<Box<dyn Backend>, String> {
    let known =
        std::env::vars_os().filter_map(|(name, value)| Some((name.into_string().ok()?, value.into_string().ok()?)));
    open_with(text, &known.filter(|(_, value)| !value.is_empty()).collect())
}

/// [`open`] with these variables in the place of those of the environment; Google and Azure read theirs there in any case.
///
/// # Errors
///
/// Those of [`open`].
pub fn open_with(text: &str, variables: &Variables) -> Result<Box<dyn Backend>, String> {
    let url = Url::parse(text).map_err(|fault| format!("`{}` is no URL: {fault}", address::shown_text(text)))?;
    let unknown = || unknown(&address::shown_text(text));
    let (scheme, prefix) = ObjectStoreScheme::parse(&url).map_err(|_| unknown())?;
    address::check(&url, &scheme)?;
    // Of several providers of cryptography none is chosen by itself; a second choice is refused, and that is right.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let timeout = timeout(variables)?;
    let is_http = scheme == ObjectStoreScheme::Http;
    let store = build(&scheme, &url, variables, timeout).map_err(|fault| match fault {
        None => unknown(),
        Some(fault) => format!("cannot use {}: {}", address::shown(&url), words(&fault)),
    })?;
    Ok(Box::new(Objects { url: address::shown(&url), runtime: runtime()?, store, prefix, is_http, timeout }))
}

fn unknown(text: &str) -> String {
    format!(
        "`{text}` is no remote place: give s3://BUCKET/PREFIX, gs://, az://, https:// (to read from), or a folder as file:///PATH"
    )
}

fn timeout(variables: &Variables) -> Result<Duration, String> {
    let Some(text) = variables.get(TIMEOUT_VARIABLE) else {
        return Ok(Duration::from_secs_f64(TIMEOUT_S));
    };
    let seconds = text.parse().ok().filter(|seconds| (0.1..=3600.0).contains(seconds));
    let seconds = seconds.ok_or_else(|| format!("{TIMEOUT_VARIABLE} is `{text}`: give seconds from 0.1 to 3600"))?;
    Ok(Duration::from_secs_f64(seconds))
}

fn runtime() -> Result<&'static Runtime, String> {
    static RUNTIME: OnceLock<Result<Runtime, String>> = OnceLock::new();
    let build = || Builder::new_multi_thread().worker_threads(1).thread_name("remote").enable_all().build();
    RUNTIME
        .get_or_init(|| build().map_err(|fault| format!("cannot start a thread: {fault}")))
        .as_ref()
        .map_err(Clone::clone)
}

/// The client for a URL; without a fault where none is known.
fn build(
    scheme: &ObjectStoreScheme,
    url: &Url,
    variables: &Variables,
    timeout: Duration,
) -> Result<Arc<dyn ObjectStore>, Option<Error>> {
    let retry = RetryConfig {
        backoff: BackoffConfig { init_backoff: Duration::from_millis(50), max_backoff: timeout / 8, base: 2.0 },
        max_retries: RETRIES,
        retry_timeout: timeout.mul_f64(0.75),
    };
    let options = ClientOptions::new()
        .with_timeout_disabled()
        .with_connect_timeout(timeout / 4)
        .with_read_timeout(timeout / 2)
        .with_allow_http(is_plain(scheme, url, variables));
    // Each provider has a builder of its own, with the same methods.
    macro_rules! built {
        ($builder:expr) => {
            $builder
                .with_retry(retry)
                .with_client_options(options)
                .with_http_connector(Direct(timeout))
                .build()
                .map(|store| Arc::new(store) as _)
        };
    }
    match scheme {
        ObjectStoreScheme::AmazonS3 => {
            let known = |(name, value): (&String, &String)| {
                let key = name.starts_with("AWS_").then(|| name.to_ascii_lowercase().parse::<AmazonS3ConfigKey>());
                Some((key?.ok()?, value.clone()))
            };
            let builder = variables.iter().filter_map(known);
            let builder = builder.fold(AmazonS3Builder::new(), |builder, (key, value)| builder.with_config(key, value));
            // Not every server knows how to remove several objects at once.
            let builder = builder.with_url(url.as_str()).with_disable_bulk_delete(true);
            built!(builder)
        }
        ObjectStoreScheme::GoogleCloudStorage => {
            let builder = GoogleCloudStorageBuilder::from_env().with_url(url.as_str());
            built!(builder)
        }
        ObjectStoreScheme::MicrosoftAzure => {
            let builder = MicrosoftAzureBuilder::from_env().with_url(url.as_str());
            built!(builder)
        }
        ObjectStoreScheme::Http => {
            let builder = HttpBuilder::new().with_url(&url[..url::Position::BeforePath]);
            built!(builder)
        }
        _ => return Err(None),
    }
    .map_err(Some)
}

/// Whether the user asked for a connection that is not encrypted.
fn is_plain(scheme: &ObjectStoreScheme, url: &Url, variables: &Variables) -> bool {
    let names = ["AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL", "AWS_ENDPOINT"];
    let endpoint = names.iter().find_map(|name| variables.get(*name));
    match scheme {
        ObjectStoreScheme::AmazonS3 => endpoint.is_some_and(|text| text.starts_with("http://")),
        _ => url.scheme() == "http",
    }
}

impl Objects {
    fn path(&self, name: &str) -> Path {
        name.split('/').filter(|part| !part.is_empty()).fold(self.prefix.clone(), Path::join)
    }

    /// Waits for a request; one that transfers `bytes` may take longer.
    fn wait<T>(&self, bytes: u64, request: impl Future<Output = Result<T, Error>>) -> Result<T, BackendError> {
        let limit = self.timeout + Duration::from_secs(bytes / LEAST_SPEED);
        let timed = async { tokio::time::timeout(limit, request).await };
        match self.runtime.block_on(timed) {
            Ok(result) => result.map_err(|fault| told(&fault)),
            Err(_) => Err(too_slow(limit)),
        }
    }

    /// The bytes of an answer. What it announced is not believed: it may take the time and the memory of what has come.
    async fn transfer(&self, found: GetResult, limit: u64) -> Result<Vec<u8>, BackendError> {
        let (begun, mut bytes) = (Instant::now(), Vec::<u8>::new());
        let mut stream = found.into_stream();
        loop {
            let allowed = self.timeout + Duration::from_secs(bytes.len() as u64 / LEAST_SPEED);
            let part = tokio::time::timeout(allowed.saturating_sub(begun.elapsed()), stream.next()).await;
            let Some(part) = part.map_err(|_| too_slow(allowed))? else { return Ok(bytes) };
            let part = part.map_err(|fault| told(&fault))?;
            let is_too_large = bytes.len() as u64 + part.len() as u64 > limit;
            if is_too_large || bytes.try_reserve(part.len()).is_err() {
                return Err(BackendError::TooLarge { limit });
            }
            bytes.extend_from_slice(&part);
        }
    }

    fn write(&self, name: &str, bytes: &[u8], mode: PutMode) -> Result<(), BackendError> {
        if self.is_http {
            return Err(BackendError::Unsupported("be written to"));
        }
        let payload = PutPayload::from(bytes.to_vec());
        let options = PutOptions { mode, ..PutOptions::default() };
        let path = self.path(name);
        self.wait(bytes.len() as u64, self.store.put_opts(&path, payload, options)).map(drop)
    }
}

impl Backend for Objects {
    fn url(&self) -> &str {
        &self.url
    }

    fn is_read_only(&self) -> bool {
        self.is_http
    }

    fn get(&self, name: &str, limit: u64) -> Result<Vec<u8>, BackendError> {
        let path = self.path(name);
        let found = self.wait(0, self.store.get(&path))?;
        if found.meta.size > limit {
            return Err(BackendError::TooLarge { limit });
        }
        self.runtime.block_on(self.transfer(found, limit))
    }

    fn put(&self, name: &str, bytes: &[u8]) -> Result<(), BackendError> {
        self.write(name, bytes, PutMode::Overwrite)
    }

    fn create(&self, name: &str, bytes: &[u8]) -> Result<bool, BackendError> {
        if self.is_http {
            return Err(BackendError::Unsupported("be written to"));
        }
        let payload = PutPayload::from(bytes.to_vec());
        let options = PutOptions { mode: PutMode::Create, ..PutOptions::default() };
        let path = self.path(name);
        let put = async {
            match self.store.put_opts(&path, payload, options).await {
                Ok(_) => Ok(true),
                Err(Error::AlreadyExists { .. } | Error::Precondition { .. }) => Ok(false),
                Err(fault) => Err(fault),
            }
        };
        self.wait(bytes.len() as u64, put)
    }

    fn list(&self, prefix: &str) -> Result<Vec<Object>, BackendError> {
        if self.is_http {
            return Err(BackendError::Unsupported("be listed"));
        }
        let path = self.path(prefix);
        let skipped = if self.prefix.as_ref().is_empty() { 0 } else { self.prefix.as_ref().len() + 1 };
        let mut stream = self.store.list(Some(&path));
        let (mut found, mut names) = (Vec::new(), HashSet::new());
        // Each page has the time of a request: a listing may have many pages, but names nothing twice.
        while let Some(meta) = self.wait(0, async { stream.next().await.transpose() })? {
            if found.len() == MOST_LISTED {
                return Err(BackendError::Unavailable(format!("its listing names more than {MOST_LISTED} objects")));
            }
            let hash = names.hasher().hash_one(meta.location.as_ref());
            if !names.insert(hash) {
                let name = &meta.location;
                return Err(BackendError::Unavailable(format!("its listing does not end: it names `{name}` again")));
            }
            found.push(Object {
                name: meta.location.as_ref().get(skipped..).unwrap_or_default().to_owned(),
                bytes: meta.size,
                modified_unix_s: u64::try_from(meta.last_modified.timestamp()).unwrap_or(0),
            });
        }
        Ok(found)
    }

    fn delete(&self, name: &str) -> Result<(), BackendError> {
        if self.is_http {
            return Err(BackendError::Unsupported("be written to"));
        }
        let path = self.path(name);
        match self.wait(0, self.store.delete(&path)) {
            Err(BackendError::Missing) => Ok(()),
            done => done,
        }
    }
}

fn too_slow(limit: Duration) -> BackendError {
    BackendError::Unavailable(format!("it did not answer within {} s", limit.as_secs_f64()))
}

/// A fault in the words of the cache.
fn told(fault: &Error) -> BackendError {
    match fault {
        Error::NotFound { .. } => BackendError::Missing,
        Error::PermissionDenied { .. } | Error::Unauthenticated { .. } => BackendError::Forbidden(words(fault)),
        Error::NotSupported { .. } | Error::NotImplemented { .. } => BackendError::Unsupported("do this"),
        _ => BackendError::Unavailable(words(fault)),
    }
}

/// What an error says, shortened: the causes repeat each other, and the answer of a server may be a whole page. Addresses in it may
/// hold passwords and signatures, those that a server leads on to too.
fn words(fault: &Error) -> String {
    const LENGTH: usize = 300;
    let text = address::without_secrets(&fault.to_string()).replace(['\n', '\r'], " ");
    let hint = if text.contains("169.254.169.254") {
        " (there are no credentials in the environment, so those of a virtual machine were looked for)"
    } else {
        ""
    };
    let end = (0..=LENGTH.min(text.len())).rev().find(|end| text.is_char_boundary(*end)).unwrap_or(0);
    let dots = if end < text.len() { "…" } else { "" };
    format!("{}{dots}{hint}", &text[..end])
}
