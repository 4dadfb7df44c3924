//! JSON or CBOR: which of them a client wants, and writing either.

use axum::http::{HeaderMap, header};
use mediatype::{MediaType, MediaTypeList, ReadParams, names};
use minicbor::Encoder;
use minicbor::data::Tag;
use serde::{Serialize, Serializer};

use crate::server::memory::{CBOR_BYTES, PARSED_BYTES};
use crate::server::problem::{Code, Problem};

/// How an answer is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Encoding {
    #[default]
    Json,
    /// RFC 8949, with typed arrays (RFC 8746).
    Cbor,
}

impl Encoding {
    pub(crate) const ALL: [Self; 2] = [Self::Json, Self::Cbor];

    pub(crate) fn content_type(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Cbor => "application/cbor",
        }
    }

    /// The refusal of a body that is not in it.
    pub(crate) fn malformed(self) -> Code {
        match self {
            Self::Json => Code::MalformedJson,
            Self::Cbor => Code::MalformedCbor,
        }
    }

    /// What a byte of a body takes, besides what [`Body::parsed_bytes`] says.
    pub(crate) fn byte_bytes(self) -> u64 {
        match self {
            Self::Json => PARSED_BYTES,
            Self::Cbor => CBOR_BYTES,
        }
    }

    /// What the client takes, and likes best; JSON without an Accept header, and where it does not matter.
    pub(crate) fn accepted(headers: &HeaderMap) -> Result<Self, Problem> {
        let mut lists = headers.get_all(header::ACCEPT).iter();
        // What nearly all send needs no parsing.
        match (lists.next(), lists.next()) {
            (None, _) => return Ok(Self::Json),
            (Some(only), None) if only == "*/*" || only == "application/json" => return Ok(Self::Json),
            (Some(_), _) => {}
        }
        let ranges = ranges(headers);
        let weights = Self::ALL.map(|encoding| (encoding, weight(&ranges, encoding.content_type())));
        let best = weights.into_iter().filter(|(_, weight)| *weight > 0.0).reduce(|a, b| if b.1 > a.1 { b } else { a });
        best.map(|(encoding, _)| encoding).ok_or_else(|| Problem::plain(Code::NotAcceptable))
    }
}

/// Whether the client takes a type of `application/`; without an Accept header it takes anything.
pub(crate) fn is_accepted(headers: &HeaderMap, media: &str) -> bool {
    !headers.contains_key(header::ACCEPT) || weight(&ranges(headers), media) > 0.0
}

/// That of the most specific range that covers a type of `application/`.
fn weight(ranges: &[(String, f32)], media: &str) -> f32 {
    let of = |covering: &str| ranges.iter().rev().find(|(range, _)| range == covering).map(|(_, weight)| *weight);
    of(media).or_else(|| of("application/*")).or_else(|| of("*/*")).unwrap_or(0.0)
}

/// The media ranges of Accept, in lower case, with their weights.
pub(crate) fn ranges(headers: &HeaderMap) -> Vec<(String, f32)> {
    let lists = headers.get_all(header::ACCEPT).iter().filter_map(|value| value.to_str().ok());
    let range = |media: MediaType<'_>| {
        let weight = media.get_param(names::Q).map_or(1.0, |q| q.as_str().trim().parse().unwrap_or(0.0));
        (format!("{}/{}", media.ty, media.subty).to_ascii_lowercase(), weight)
    };
    lists.flat_map(MediaTypeList::new).flatten().map(range).collect()
}

/// Writes an answer a part at a time: maps and lists whose members are written one after the other, in either encoding.
#[derive(Debug, Clone)]
pub(crate) struct Writer {
    pub(crate) encoding: Encoding,
    pub(crate) bytes: Vec<u8>,
    /// Whether nothing stands before the next member, from which a comma would part it.
    is_first: bool,
}

const INFALLIBLE: &str = "a buffer takes everything";

impl Writer {
    pub(crate) fn new(encoding: Encoding) -> Self {
        Self { encoding, bytes: Vec::new(), is_first: true }
    }

    pub(crate) fn begin_map(&mut self, len: usize) {
        self.begin(b'{', |cbor| cbor.map(len as u64).map(drop));
    }

    pub(crate) fn end_map(&mut self) {
        self.end(b'}');
    }

    pub(crate) fn begin_list(&mut self, len: usize) {
        self.begin(b'[', |cbor| cbor.array(len as u64).map(drop));
    }

    pub(crate) fn end_list(&mut self) {
        self.end(b']');
    }

    /// The name of the member of a map that is written next.
    pub(crate) fn key(&mut self, name: &str) {
        self.item();
        self.value(&name);
        if self.encoding == Encoding::Json {
            self.bytes.push(b':');
        }
    }

    /// Before each member of a list.
    pub(crate) fn item(&mut self) {
        if self.encoding == Encoding::Json && !std::mem::take(&mut self.is_first) {
            self.bytes.push(b',');
        }
    }

    pub(crate) fn value<T: Serialize + ?Sized>(&mut self, value: &T) {
        const PLAIN: &str = "answers are structs of numbers, strings and lists";
        match self.encoding {
            Encoding::Json => serde_json::to_writer(&mut self.bytes, value).expect(PLAIN),
            Encoding::Cbor => {
                let mut serializer = minicbor_serde::Serializer::new(&mut self.bytes);
                value.serialize(serializer.serialize_unit_as_null(true)).expect(PLAIN);
            }
        }
    }

    /// A struct whose last member is `()`, without that value and without an end: what is written next takes its place.
    pub(crate) fn value_without_end<T: Serialize>(&mut self, value: &T) {
        self.value(value);
        let unit = match self.encoding {
            Encoding::Json => "null}".len(),
            Encoding::Cbor => 1,
        };
        self.bytes.truncate(self.bytes.len() - unit);
    }

    /// Some members of a list.
    pub(crate) fn members<T: Serialize>(&mut self, members: impl ExactSizeIterator<Item = T>) {
        if members.len() == 0 {
            return;
        }
        match self.encoding {
            Encoding::Json => {
                let start = self.bytes.len();
                serde_json::Serializer::new(&mut self.bytes).collect_seq(members).expect("numbers");
                // The brackets are those of the whole list.
                self.bytes.pop();
                if std::mem::take(&mut self.is_first) {
                    self.bytes.remove(start);
                } else {
                    self.bytes[start] = b',';
                }
            }
            Encoding::Cbor => members.for_each(|member| self.value(&member)),
        }
    }

    /// Begins a typed array of so many bytes (CBOR).
    pub(crate) fn begin_typed(&mut self, tag: u64, bytes: usize) {
        self.cbor(|cbor| cbor.tag(Tag::new(tag))?.bytes_len(bytes as u64).map(drop));
    }

    fn begin(&mut self, bracket: u8, head: impl FnOnce(&mut Encoder<&mut Vec<u8>>) -> Written) {
        match self.encoding {
            Encoding::Json => self.bytes.push(bracket),
            Encoding::Cbor => self.cbor(head),
        }
        self.is_first = true;
    }

    fn end(&mut self, bracket: u8) {
        if self.encoding == Encoding::Json {
            self.bytes.push(bracket);
        }
        self.is_first = false;
    }

    fn cbor(&mut self, write: impl FnOnce(&mut Encoder<&mut Vec<u8>>) -> Written) {
        write(&mut Encoder::new(&mut self.bytes)).expect(INFALLIBLE);
    }
}

type Written = Result<(), minicbor::encode::Error<std::convert::Infallible>>;

#[cfg(test)]
mod tests {
    use super::{Code, Encoding, HeaderMap, header};
    use axum::http::HeaderValue;

    #[test]
    fn accept_is_read_with_its_weights() {
        const JSON: Option<Encoding> = Some(Encoding::Json);
        const CBOR: Option<Encoding> = Some(Encoding::Cbor);
        for (accept, wanted) in [
            ("application/json", JSON),
            ("*/*", JSON),
            ("application/*;q=0.2", JSON),
            ("text/html, application/json;q=0.5", JSON),
            ("text/html", None),
            ("application/json;q=0, */*", CBOR),
            ("application/json;q=0, */*;q=0", None),
            ("application/cbor", CBOR),
            ("Application/CBOR", CBOR),
            ("application/cbor, application/json", JSON),
            ("application/cbor, application/json;q=0.9", CBOR),
            ("application/cbor;q=0.5, */*;q=0.1", CBOR),
            ("application/cbor;q=0.5, */*;q=0.6", JSON),
            ("application/cbor;q=0, application/*", JSON),
            ("application/cbor;q=nonsense", None),
            ("", None),
        ] {
            let headers = HeaderMap::from_iter([(header::ACCEPT, HeaderValue::from_static(accept))]);
            assert_eq!(Encoding::accepted(&headers).ok(), wanted, "{accept}");
        }
        let two = ["application/cbor", "application/json;q=0.1"];
        let two = HeaderMap::from_iter(two.map(|value| (header::ACCEPT, HeaderValue::from_static(value))));
        assert_eq!(Encoding::accepted(&two).ok(), CBOR);
        assert_eq!(Encoding::accepted(&HeaderMap::new()).ok(), JSON);
        let refused = HeaderMap::from_iter([(header::ACCEPT, HeaderValue::from_static("image/png"))]);
        assert_eq!(Encoding::accepted(&refused).map_err(|problem| problem.code), Err(Code::NotAcceptable));
    }
}
