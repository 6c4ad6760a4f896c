//! Making any string safe to put into a page.

/// `text` as HTML or XML character data or a quoted attribute value. Control characters, which XML forbids,
/// become U+FFFD.
pub fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            c if c.is_control() && !matches!(c, '\n' | '\t') => escaped.push('\u{fffd}'),
            c => escaped.push(c),
        }
    }
    escaped
}

/// `json` as the content of a `<script>` element: no `</script>`, `<!--` or `]]>` can appear in it, and a JSON
/// parser reads the same value, because `<` and `>` occur in JSON only within strings.
pub fn json_in_script(json: &str) -> String {
    json.replace('<', "\\u003c")
        .replace('>', "\\u003e")
        .replace('\u{2028}', "\\u2028")
        .replace('\u{2029}', "\\u2029")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn markup_becomes_text() {
        assert_eq!(
            escape("<img src=x onerror='a(\"b\")'>&\u{1}"),
            "&lt;img src=x onerror=&#39;a(&quot;b&quot;)&#39;&gt;&amp;\u{fffd}"
        );
    }

    #[test]
    fn json_keeps_its_value_and_cannot_end_the_script() {
        let value = serde_json::json!({"name": "</script><!-- ]]> \u{2028}"});
        let safe = json_in_script(&value.to_string());
        assert!(!safe.contains('<') && !safe.contains('>') && !safe.contains('\u{2028}'));
        assert_eq!(serde_json::from_str::<serde_json::Value>(&safe).unwrap(), value);
    }
}
