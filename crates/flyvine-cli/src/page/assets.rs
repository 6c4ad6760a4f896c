//! The page's files, bundled.

/// A file of the page.
pub struct Asset {
    /// Its path below the page's own address.
    pub path: &'static str,
    /// MIME type.
    pub content_type: &'static str,
    /// Its bytes.
    pub bytes: &'static [u8],
}

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";

macro_rules! asset {
    ($path:literal, $content_type:expr, $file:literal) => {
        Asset {
            path: $path,
            content_type: $content_type,
            bytes: include_bytes!(concat!("../../web/", $file)),
        }
    };
}

/// All of them; the empty path is the page itself.
pub const ASSETS: [Asset; 13] = [
    asset!("", HTML, "index.html"),
    asset!("style.css", CSS, "style.css"),
    asset!("icon.svg", "image/svg+xml", "icon.svg"),
    asset!("app.js", SCRIPT, "src/app.js"),
    asset!("flight.js", SCRIPT, "src/flight.js"),
    asset!("live.js", SCRIPT, "src/live.js"),
    asset!("plots.js", SCRIPT, "src/plots.js"),
    asset!("scene.js", SCRIPT, "src/scene.js"),
    asset!("theme.js", SCRIPT, "src/theme.js"),
    asset!(
        "vendor/uPlot.iife.min.js",
        SCRIPT,
        "vendor/uplot/uPlot.iife.min.js"
    ),
    asset!("vendor/uPlot.min.css", CSS, "vendor/uplot/uPlot.min.css"),
    Asset {
        path: "models.js",
        content_type: SCRIPT,
        bytes: flyvine::report::MODELS.as_bytes(),
    },
    Asset {
        path: "vendor/three.min.js",
        content_type: SCRIPT,
        bytes: flyvine::report::THREE.as_bytes(),
    },
];
