//! Addresses of remote places: which are refused, and how they are shown, since passwords and signatures may be part of them.

use object_store::ObjectStoreScheme;
use url::Url;

/// Refuses an address with a part that is never sent, so that nobody believes that it is.
///
/// # Errors
///
/// What is not sent, and the way out, in words.
pub fn check(url: &Url, scheme: &ObjectStoreScheme) -> Result<(), String> {
    let unsent = match url {
        url if url.password().is_some() || !(url.username().is_empty() || has_container(url)) => "user and password",
        url if url.query().is_some() => "what begins with `?`",
        url if url.fragment().is_some() => "what begins with `#`",
        _ => return Ok(()),
    };
    let way = match scheme {
        ObjectStoreScheme::Http => {
            "give an address that can be read without, or an object store such as s3://BUCKET/PREFIX, whose credentials come \
             from the environment"
        }
        ObjectStoreScheme::MicrosoftAzure => {
            "credentials come from the environment, such as AZURE_STORAGE_ACCOUNT_KEY or AZURE_STORAGE_SAS_TOKEN"
        }
        ObjectStoreScheme::GoogleCloudStorage => {
            "credentials come from the environment, such as GOOGLE_SERVICE_ACCOUNT"
        }
        _ => "credentials come from the environment, such as AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY",
    };
    Err(format!("{}: {unsent} in the address of a remote place would not be sent: {way}", shown(url)))
}

/// Whether a container stands in the place of a user: `abfss://CONTAINER@ACCOUNT.dfs.core.windows.net/`.
fn has_container(url: &Url) -> bool {
    matches!(url.scheme(), "az" | "abfs" | "abfss") && !url.username().is_empty() && url.password().is_none()
}

/// The address as it may be shown.
pub fn shown(url: &Url) -> String {
    let text = without_secrets(url.as_str());
    if has_container(url) { text.replacen("://", &format!("://{}@", url.username()), 1) } else { text }
}

/// What may be shown of a text that is no address, though it was meant as one: nothing in front of an `@`, or behind a `?` or `#`.
pub fn shown_text(text: &str) -> String {
    let Some((secret, place)) = text.rsplit_once('@') else { return without_secrets(text) };
    let scheme = secret.split_once("://").map_or_else(String::new, |(scheme, _)| format!("{scheme}://"));
    format!("{scheme}…@{}", place.split(['?', '#']).next().unwrap_or_default())
}

/// A text without users, passwords and queries of the addresses in it.
pub fn without_secrets(text: &str) -> String {
    let (mut shown, mut rest) = (String::with_capacity(text.len()), text);
    while let Some((before, address)) = rest.split_once("://") {
        shown += before;
        shown += "://";
        let ends = |sign: char| sign.is_whitespace() || "\"<>`\\".contains(sign);
        let (address, further) = address.split_at(address.find(ends).unwrap_or(address.len()));
        let (place, path) = address.split_at(address.find(['/', '?', '#']).unwrap_or(address.len()));
        let place = place.rsplit_once('@').map_or(place, |(_, place)| place);
        shown += place;
        let (path, query) = path.split_at(path.find(['?', '#']).unwrap_or(path.len()));
        shown += path;
        if let Some(sign) = query.chars().next() {
            let punctuation = query.trim_end_matches([')', ',', '.', ':', ';', '\'']).len();
            shown += &format!("{sign}…{}", &query[punctuation.max(1)..]);
        }
        rest = further;
    }
    shown + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn users_passwords_and_queries_are_not_shown() {
        for (text, expected) in [
            ("no address: a@b?c", "no address: a@b?c"),
            (
                "Error for url (http://alice:S3cretPw@h:1/a/b?sig=x&y=z): refused",
                "Error for url (http://h:1/a/b?…): refused",
            ),
            ("at https://t0ken@h, http://a:b@c@h and s3://b/c@d", "at https://h, http://h and s3://b/c@d"),
            ("\"http://a:p)w'@h/x\" \"https://h?q\".", "\"http://h/x\" \"https://h?…\"."),
            ("http://a:b@", "http://"),
            ("(https://h/a#b).", "(https://h/a#…)."),
            ("https://h?", "https://h?…"),
            ("://", "://"),
        ] {
            assert_eq!(without_secrets(text), expected);
        }
        assert_eq!(shown_text("http://alice:S3cret/pw@h:1/a?sig=x"), "http://…@h:1/a");
        assert_eq!(shown_text("alice:S3cret@h"), "…@h");
        assert_eq!(shown_text("http://h:x/a?sig=x"), "http://h:x/a?…");
    }
}
