//! Compressed answers, for clients that ask for them.

use std::io::{self, Write};

use axum::http::{HeaderMap, header};
use flate2::Compression;
use flate2::write::GzEncoder;

/// How the bytes of an answer are packed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Coding {
    Zstd,
    Gzip,
}

/// Digits halve at once; higher levels take twice the time for a few percent.
const GZIP_LEVEL: u32 = 2;
const ZSTD_LEVEL: i32 = 1;

impl Coding {
    /// The faster first.
    const ALL: [Self; 2] = [Self::Zstd, Self::Gzip];

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Zstd => "zstd",
            Self::Gzip => "gzip",
        }
    }

    /// What the client names and likes at least as much as an answer as it is; `*` asks for nothing.
    pub(crate) fn accepted(headers: &HeaderMap) -> Option<Self> {
        if !headers.contains_key(header::ACCEPT_ENCODING) {
            return None;
        }
        let asked = Self::ALL.into_iter().filter_map(|coding| Some((coding, coding.asked(headers)?)));
        asked.reduce(|a, b| if b.1 > a.1 { b } else { a }).map(|(coding, _)| coding)
    }

    /// Whether the client names this one, however much it likes another.
    pub(crate) fn is_accepted(self, headers: &HeaderMap) -> bool {
        self.asked(headers).is_some()
    }

    /// The weight of this one, where it is named and liked at least as much as an answer as it is.
    fn asked(self, headers: &HeaderMap) -> Option<f32> {
        let plain = weight(headers, "identity").unwrap_or(0.0);
        weight(headers, self.name()).filter(|weight| *weight > 0.0 && *weight >= plain)
    }
}

fn weight(headers: &HeaderMap, name: &str) -> Option<f32> {
    let lists = headers.get_all(header::ACCEPT_ENCODING).iter().filter_map(|value| value.to_str().ok());
    lists.flat_map(|list| list.split(',')).find_map(|item| {
        let (coding, weight) = item.split_once(';').unwrap_or((item, "q=1"));
        let weight = weight.trim().strip_prefix("q=").and_then(|weight| weight.parse::<f32>().ok());
        coding.trim().eq_ignore_ascii_case(name).then_some(weight.unwrap_or(0.0))
    })
}

/// Packs an answer a piece at a time.
pub(crate) enum Packer {
    Zstd(zstd::stream::write::Encoder<'static, Vec<u8>>),
    Gzip(GzEncoder<Vec<u8>>),
}

impl Packer {
    pub(crate) fn new(coding: Coding) -> Self {
        match coding {
            Coding::Zstd => Self::Zstd(
                zstd::stream::write::Encoder::new(Vec::new(), ZSTD_LEVEL).expect("it fails without memory alone"),
            ),
            Coding::Gzip => Self::Gzip(GzEncoder::new(Vec::new(), Compression::new(GZIP_LEVEL))),
        }
    }

    /// What is to be sent after this piece: perhaps nothing yet.
    pub(crate) fn pack(&mut self, piece: &[u8]) -> io::Result<Vec<u8>> {
        let packed = match self {
            Self::Zstd(encoder) => {
                encoder.write_all(piece)?;
                encoder.get_mut()
            }
            Self::Gzip(encoder) => {
                encoder.write_all(piece)?;
                encoder.get_mut()
            }
        };
        Ok(std::mem::take(packed))
    }

    /// The rest.
    pub(crate) fn finish(self) -> io::Result<Vec<u8>> {
        match self {
            Self::Zstd(encoder) => encoder.finish(),
            Self::Gzip(encoder) => encoder.finish(),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use super::{Coding, HeaderMap, Packer, header};
    use axum::http::HeaderValue;

    #[test]
    fn a_coding_is_used_when_it_is_asked_for_by_name() {
        for (accept, coding) in [
            ("gzip", Some(Coding::Gzip)),
            ("gzip, deflate, br, zstd", Some(Coding::Zstd)),
            ("zstd;q=0.5, GZIP", Some(Coding::Gzip)),
            ("gzip;q=0", None),
            ("gzip;q=0.5, identity", None),
            ("gzip; q=0.5, identity;q=0.5", Some(Coding::Gzip)),
            ("*", None),
            ("br", None),
            ("identity", None),
            ("", None),
        ] {
            let headers = HeaderMap::from_iter([(header::ACCEPT_ENCODING, HeaderValue::from_static(accept))]);
            assert_eq!(Coding::accepted(&headers), coding, "{accept}");
        }
        assert_eq!(Coding::accepted(&HeaderMap::new()), None);
    }

    #[test]
    fn what_is_packed_in_pieces_is_unpacked_as_one() {
        let text: Vec<u8> = (0..100_000).flat_map(|k: u32| format!("{},", f64::from(k).sqrt()).into_bytes()).collect();
        for coding in Coding::ALL {
            let mut packer = Packer::new(coding);
            let pieces = text.chunks(1 << 16).map(|piece| packer.pack(piece).expect("into memory"));
            let mut packed: Vec<u8> = pieces.collect::<Vec<_>>().concat();
            packed.extend(packer.finish().expect("into memory"));
            let mut unpacked = Vec::new();
            match coding {
                Coding::Zstd => {
                    zstd::stream::read::Decoder::new(&packed[..]).expect("memory").read_to_end(&mut unpacked)
                }
                Coding::Gzip => flate2::read::GzDecoder::new(&packed[..]).read_to_end(&mut unpacked),
            }
            .expect("whole");
            assert!(unpacked == text && packed.len() * 5 < text.len() * 3, "{} of {}", packed.len(), text.len());
        }
    }
}
