//! Connections to object stores that do not go where a server sends them, and do not read more than an answer can need.
//!
//! A server, or whoever stands in for it, may answer with the address of another one: that one would get the names that are asked for, and of
//! the credentials those that are no `Authorization`. So only addresses of the same server are followed.

use std::pin::Pin;
use std::time::Duration;

use http_body_util::{BodyExt, Limited};
use object_store::client::{
    ClientConfigKey, HttpClient, HttpConnector, HttpError, HttpErrorKind, HttpRequest, HttpResponse, HttpResponseBody,
    HttpService,
};
use object_store::{ClientOptions, Error};
use reqwest::redirect::{Attempt, Policy};

/// Addresses of one server that are followed, one after the other.
const MOST_REDIRECTS: usize = 5;
/// The longest page of a listing, and the longest answer that says what is wrong, bytes: sixteen times a page of a thousand names of a kilobyte.
const PAGE_BYTES: usize = 16 << 20;

/// Makes connections; a request may take this long with all its repetitions.
#[derive(Debug)]
pub struct Direct(pub Duration);

impl HttpConnector for Direct {
    fn connect(&self, options: &ClientOptions) -> Result<HttpClient, Error> {
        let Self(timeout) = *self;
        let said = |options: &ClientOptions, key| options.get_config_value(&key);
        // The service of a virtual machine that gives credentials has to be quick, or is not there.
        let metadata = ClientOptions::new().with_connect_timeout(Duration::from_secs(1));
        let connect = || ClientConfigKey::ConnectTimeout;
        let is_metadata = said(options, connect()) == said(&metadata, connect());
        let is_plain = said(options, ClientConfigKey::AllowHttp).is_some_and(|text| text == "true");
        let client = reqwest::Client::builder()
            .user_agent(concat!("rockface/", env!("CARGO_PKG_VERSION")))
            .redirect(Policy::custom(|attempt| if stays(&attempt) { attempt.follow() } else { attempt.stop() }))
            .connect_timeout(if is_metadata { Duration::from_secs(1) } else { timeout / 4 })
            .read_timeout(timeout / 2)
            .https_only(!is_plain)
            .build();
        let fault = |source: reqwest::Error| Error::Generic { store: "HTTP client", source: source.into() };
        Ok(HttpClient::new(Bounded(client.map_err(fault)?)))
    }
}

/// Whether an address is one of the server that was asked first.
fn stays(attempt: &Attempt) -> bool {
    let asked = attempt.previous();
    asked.len() <= MOST_REDIRECTS && asked.first().is_some_and(|first| first.origin() == attempt.url().origin())
}

/// A client that reads no more of a listing, or of what is said of a fault, than either can need.
#[derive(Debug)]
struct Bounded(reqwest::Client);

impl HttpService for Bounded {
    fn call<'s, 'f>(
        &'s self,
        request: HttpRequest,
    ) -> Pin<Box<dyn Future<Output = Result<HttpResponse, HttpError>> + Send + 'f>>
    where
        's: 'f,
        Self: 'f,
    {
        let is_listing =
            request.uri().query().is_some_and(|query| query.contains("list-type=") || query.contains("comp=list"));
        Box::pin(async move {
            let answer = self.0.call(request).await?;
            if answer.status().is_success() && !is_listing {
                return Ok(answer);
            }
            let (head, body) = answer.into_parts();
            let body = Limited::new(body, PAGE_BYTES)
                .map_err(|fault| HttpError::new(HttpErrorKind::Decode, std::io::Error::other(fault)));
            Ok(HttpResponse::from_parts(head, HttpResponseBody::new(body)))
        })
    }
}
