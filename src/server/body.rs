//! The body of a request, and parts of it that are not read yet.

use axum::body::Bytes;
use serde::de::{Deserialize, Deserializer, Visitor};
use serde_json::value::RawValue;

use crate::server::cbor::{self, Census, TypedArray};
use crate::server::encoding::Encoding;
use crate::server::json;
use crate::server::memory::{OBJECT_BYTES, objects};
use crate::server::problem::Problem;

/// The body of a request.
#[derive(Debug, Clone, Default)]
pub(crate) struct Body {
    pub(crate) bytes: Bytes,
    pub(crate) encoding: Encoding,
}

impl Body {
    /// The whole of it.
    pub(crate) fn raw(&self) -> Result<Raw<'_>, Problem> {
        match self.encoding {
            Encoding::Json => json::text(&self.bytes).map(Raw::Json),
            Encoding::Cbor => Ok(Raw::Cbor(cbor::without_mark(&self.bytes))),
        }
    }

    /// Reads it; what is not in its encoding at all is malformed, what is the wrong thing says where.
    pub(crate) fn read<'a, T: Deserialize<'a>>(&'a self) -> Result<T, Problem> {
        self.raw()?.read("")
    }

    /// A part of it, without a copy.
    pub(crate) fn part(&self, raw: Raw<'_>) -> Self {
        Self { bytes: self.bytes.slice_ref(raw.bytes()), encoding: self.encoding }
    }

    /// At least as many as there are objects in it.
    pub(crate) fn objects(&self) -> u64 {
        match self.encoding {
            Encoding::Json => objects(&self.bytes),
            Encoding::Cbor => Census::of(&self.bytes).objects,
        }
    }

    /// Bytes that it is parsed into, besides what is charged for each byte of it. More than so many objects are refused
    /// before they are parsed.
    pub(crate) fn parsed_bytes(&self, objects_max: u64) -> u64 {
        match self.encoding {
            Encoding::Json => objects(&self.bytes).min(objects_max) * OBJECT_BYTES,
            Encoding::Cbor => {
                let census = Census::of(&self.bytes);
                census.objects.min(objects_max) * OBJECT_BYTES + census.bytes()
            }
        }
    }
}

/// A body or a part of it, not yet read: what it is to be depends on the precision of the world, or on how it begins.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Raw<'a> {
    Json(&'a str),
    Cbor(&'a [u8]),
}

impl<'a> Raw<'a> {
    fn bytes(self) -> &'a [u8] {
        match self {
            Self::Json(text) => text.as_bytes(),
            Self::Cbor(bytes) => bytes,
        }
    }

    /// Reads it; `prefix` is the pointer to it.
    pub(crate) fn read<T: Deserialize<'a>>(self, prefix: &str) -> Result<T, Problem> {
        match self {
            Self::Json(text) => json::parse_part(text, prefix),
            Self::Cbor(bytes) => cbor::read(bytes, prefix),
        }
    }

    /// Whether it begins as text.
    pub(crate) fn is_text(self) -> bool {
        match self {
            Self::Json(text) => text.trim_ascii_start().starts_with('"'),
            Self::Cbor(bytes) => cbor::is_text(bytes),
        }
    }

    /// Whether it begins as a list.
    pub(crate) fn is_list(self) -> bool {
        match self {
            Self::Json(text) => text.trim_ascii_start().starts_with('['),
            Self::Cbor(bytes) => cbor::is_list(bytes),
        }
    }

    /// Whether it begins as a list of lists, of which some may be null; an empty list is one.
    pub(crate) fn is_list_of_lists(self) -> bool {
        match self {
            Self::Json(text) => {
                let inside = text.trim_ascii_start().strip_prefix('[').map(str::trim_ascii_start);
                inside.is_some_and(|inside| inside.starts_with(['[', 'n', ']']))
            }
            Self::Cbor(bytes) => cbor::is_list_of_lists(bytes),
        }
    }

    /// Its numbers, if it is a typed array.
    pub(crate) fn typed_array(self) -> Option<TypedArray<'a>> {
        match self {
            Self::Json(_) => None,
            Self::Cbor(bytes) => cbor::typed_array(bytes),
        }
    }

    /// At least as many as there are objects in it.
    pub(crate) fn objects(self) -> u64 {
        match self {
            Self::Json(text) => objects(text.as_bytes()),
            Self::Cbor(bytes) => Census::of(bytes).objects,
        }
    }
}

/// What a deserializer is asked for where a part is to stay as it is.
pub(crate) const RAW: &str = "pointmass::Raw";

impl<'de: 'a, 'a> Deserialize<'de> for Raw<'a> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Part;
        impl<'de> Visitor<'de> for Part {
            type Value = Raw<'de>;
            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("any value")
            }
            /// JSON does not know the name.
            fn visit_newtype_struct<D: Deserializer<'de>>(self, deserializer: D) -> Result<Raw<'de>, D::Error> {
                <&RawValue>::deserialize(deserializer).map(|raw| Raw::Json(raw.get()))
            }
            fn visit_borrowed_bytes<E>(self, bytes: &'de [u8]) -> Result<Raw<'de>, E> {
                Ok(Raw::Cbor(bytes))
            }
        }
        deserializer.deserialize_newtype_struct(RAW, Part)
    }
}
