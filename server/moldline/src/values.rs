//! Values of options: parsers that several commands share.

use std::{net::SocketAddr, num::NonZeroUsize, time::Duration};

/// The number of threads given, or one per core.
pub(crate) fn threads(given: Option<NonZeroUsize>) -> usize {
    given.or_else(|| std::thread::available_parallelism().ok()).map_or(1, NonZeroUsize::get)
}

/// A number of seconds that a `Duration` can hold.
pub(crate) fn seconds(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|error| format!("{error}"))?;
    Duration::try_from_secs_f64(value).map(|_| value).map_err(|error| error.to_string())
}

/// An address with its port. `localhost` is 127.0.0.1, so that no name service decides who can reach a server.
pub(crate) fn address(text: &str) -> Result<SocketAddr, String> {
    let numeric = match text.strip_prefix("localhost:") {
        Some(port) => format!("127.0.0.1:{port}"),
        None => text.to_owned(),
    };
    numeric
        .parse()
        .map_err(|_| "expected an address and a port, as in 127.0.0.1:50051 or localhost:50051".to_owned())
}

/// A duration with its units.
pub(crate) fn duration(text: &str) -> Result<Duration, String> {
    humantime::parse_duration(text).map_err(|error| {
        format!("{error}; expected a number and one of s, m, h and d, as in 90s, 30m, 24h or 7d")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn localhost_is_an_address() {
        assert_eq!(address("localhost:50051"), address("127.0.0.1:50051"));
        assert_eq!(address("[::1]:0").unwrap().port(), 0);
        assert!(address("localhost").unwrap_err().contains("a port"));
    }

    #[test]
    fn durations_have_a_unit() {
        for (text, seconds) in
            [("45s", 45), ("30m", 1800), ("24h", 86_400), ("7d", 604_800), ("1h 30m", 5400)]
        {
            assert_eq!(duration(text).unwrap(), Duration::from_secs(seconds), "{text}");
        }
        for text in ["24", "h", "-1h", "", "1.5.h", "999999999999999999999d"] {
            assert!(duration(text).unwrap_err().contains("24h"), "{text}");
        }
    }
}
