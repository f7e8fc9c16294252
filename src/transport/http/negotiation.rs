//! Content negotiation of arrays (RFC 9110 §12.5.1): which representation `Accept` asks for.

use axum::http::{HeaderMap, header};

/// Chooses from `offered` (media types, preferred first) by the request's `Accept` headers; `None`
/// if none of them is acceptable. No `Accept` at all accepts everything.
pub(super) fn choose(headers: &HeaderMap, offered: &[&'static str]) -> Option<&'static str> {
    let ranges: Vec<Range> = headers
        .get_all(header::ACCEPT)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(','))
        .filter_map(Range::parse)
        .collect();
    if ranges.is_empty() && !headers.contains_key(header::ACCEPT) {
        return offered.first().copied();
    }
    let mut best: Option<(&'static str, f32)> = None;
    for media in offered {
        let quality = ranges
            .iter()
            .filter_map(|range| Some((range.specificity(media)?, range.quality)))
            .max_by_key(|(specificity, _)| *specificity)
            .map_or(0.0, |(_, quality)| quality);
        if quality > best.map_or(0.0, |(_, best)| best) {
            best = Some((media, quality));
        }
    }
    best.map(|(media, _)| media)
}

/// One media range of an `Accept` header.
struct Range<'a> {
    kind: &'a str,
    subtype: &'a str,
    quality: f32,
}

impl<'a> Range<'a> {
    /// `type/subtype;q=…`; anything else is ignored, as an unknown type would be.
    fn parse(text: &'a str) -> Option<Range<'a>> {
        let mut parts = text.split(';').map(str::trim);
        let (kind, subtype) = parts.next()?.split_once('/')?;
        let quality = parts
            .filter_map(|parameter| parameter.split_once('='))
            .find(|(name, _)| name.trim().eq_ignore_ascii_case("q"))
            .map_or(Some(1.0), |(_, value)| value.trim().parse().ok())
            .filter(|quality: &f32| (0.0..=1.0).contains(quality))?;
        Some(Range { kind, subtype, quality })
    }

    /// How exactly this range names `media` (2 exact, 1 its type, 0 everything), if it covers it.
    fn specificity(&self, media: &str) -> Option<u8> {
        let (kind, subtype) = media.split_once('/')?;
        match (self.kind, self.subtype) {
            ("*", "*") => Some(0),
            (k, "*") if k.eq_ignore_ascii_case(kind) => Some(1),
            (k, s) if k.eq_ignore_ascii_case(kind) && s.eq_ignore_ascii_case(subtype) => Some(2),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;
    use sutura_proto::media::{FRAME, NPY};

    fn chosen(accept: Option<&'static str>) -> Option<&'static str> {
        let mut headers = HeaderMap::new();
        if let Some(accept) = accept {
            headers.insert(header::ACCEPT, HeaderValue::from_static(accept));
        }
        choose(&headers, &[NPY, FRAME])
    }

    #[test]
    fn the_first_offer_is_the_default() {
        for accept in [None, Some("*/*"), Some("application/*"), Some("text/html, */*;q=0.1")] {
            assert_eq!(chosen(accept), Some(NPY), "{accept:?}");
        }
    }

    #[test]
    fn quality_decides_and_the_exact_range_overrides_the_wide_one() {
        assert_eq!(chosen(Some(FRAME)), Some(FRAME));
        assert_eq!(chosen(Some("Application/VND.sutura.Frame")), Some(FRAME));
        assert_eq!(
            chosen(Some("application/x-npy;q=0.2, application/vnd.sutura.frame;q=0.9")),
            Some(FRAME)
        );
        assert_eq!(chosen(Some("application/x-npy;q=0, */*")), Some(FRAME));
        assert_eq!(chosen(Some("application/x-npy;q=0.1, */*")), Some(FRAME));
    }

    #[test]
    fn nothing_acceptable_is_none() {
        for accept in ["application/json", "text/*", "", "nonsense", "*/*;q=0", "*/*;q=nan"] {
            assert_eq!(chosen(Some(accept)), None, "{accept:?}");
        }
    }
}
