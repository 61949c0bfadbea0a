//! Texts of `--help` that differ between builds with and without the simulated bench.

/// A text for builds with the bench, and one for those without.
macro_rules! text {
    ($(#[$doc:meta])* $name:ident: $with:expr, $without:expr $(,)?) => {
        $(#[$doc])*
        pub const $name: &str = if cfg!(feature = "bench") { $with } else { $without };
    };
}

text!(
    /// The first command.
    START: "Start with: flankscope inspect --report out",
    "Start with: flankscope inspect --link PORT --tool DIR --report out"
);
text!(
    /// Of `--link`.
    LINK: "Controller: `sim` for the simulated bench, `qemu` for the bench with the emulated firmware image, else a serial port \
           such as /dev/ttyACM0 [default: sim, for the built-in demo alone]",
    "Controller: a serial port such as /dev/ttyACM0"
);
text!(LINK_VALUES: "sim|qemu|PORT", "PORT");
text!(
    /// Of `--tool`.
    TOOL: "Folder with tool.toml and, for another head than the demo's, head.toml [default: the demo die]",
    "Folder with tool.toml and head.toml"
);
text!(
    /// Of `--target`.
    TARGET: "Folder with target.toml and the head.toml to start from [default: the demo target]",
    "Folder with target.toml and the head.toml to start from"
);
text!(
    INSPECT: "Check the critical teeth now: position, capture, register, judge.\n\n\
              Without options the built-in demo die is checked on the simulated bench.",
    "Check the critical teeth now: position, capture, register, judge."
);
text!(
    INSPECT_EXAMPLE: "Example:\n  flankscope inspect --wear 40:left:80 --report out\n\
        checks the demo die with 80 um worn off the left flank of tooth 40 and writes out/report.html\n\n  \
        flankscope inspect --tool DIR --link /dev/ttyACM0 --history press.db\n\
        checks a die in a press and stores the result. --tool and --history need --link, so that a simulated result is never taken for \
        one of a press; a history holds checks of one kind only.",
    "Example:\n  flankscope inspect --tool DIR --link /dev/ttyACM0 --history press.db\n\
        checks a die in a press and stores the result."
);
text!(
    VIEW: "Live view of one tooth for setting up the head at the die: levels, saturation, contrast, focus, exposures.\n\n\
        The head moves to the tooth as in a check, captures the view and leaves the die again, until Ctrl-C or --captures. Every \
        capture is a line and, with --page, a page that a browser loads again by itself. Nothing is judged or stored.\n\n\
        Without options the built-in demo die is viewed on the simulated bench.",
    "Live view of one tooth for setting up the head at the die: levels, saturation, contrast, focus, exposures.\n\n\
        The head moves to the tooth as in a check, captures the view and leaves the die again, until Ctrl-C or --captures. Every \
        capture is a line and, with --page, a page that a browser loads again by itself. Nothing is judged or stored."
);
text!(
    VIEW_EXAMPLE: "Example:\n  flankscope view --page view.html\n\
        views the first tooth of the demo die until Ctrl-C and writes view.html after every capture\n\n  \
        flankscope view --tool DIR --link /dev/ttyACM0 --tooth 40 --captures 3 --write-exposures\n\
        captures tooth 40 three times and writes exposures that suit it into the head file",
    "Example:\n  flankscope view --tool DIR --link /dev/ttyACM0 --page view.html\n\
        views the tool's first tooth until Ctrl-C and writes view.html after every capture\n\n  \
        flankscope view --tool DIR --link /dev/ttyACM0 --tooth 40 --captures 3 --write-exposures\n\
        captures tooth 40 three times and writes exposures that suit it into the head file"
);
text!(
    SCAN: "Scan the whole die: many views, registered to the CAD together and merged into one map.\n\n\
        Without options the built-in demo die is scanned on the simulated bench, where it stands eccentric and tilted and the \
        hand-eye transform is only roughly known. With --session an interrupted scan is continued.",
    "Scan the whole die: many views, registered to the CAD together and merged into one map.\n\n\
        With --session an interrupted scan is continued."
);
text!(
    SCAN_EXAMPLE: "Example:\n  flankscope scan --views 12x2 --speed max --report out\n\
        scans the demo die and writes out/report.html, out/scan.json and out/map.ply\n\n  \
        flankscope bench example > bench.toml\n  \
        flankscope scan --views 12x2 --speed max --bench bench.toml --report out\n\
        scans a die with the form errors in bench.toml, for example ovality_um = 20",
    "Example:\n  flankscope scan --views 84x7 --tool DIR --link /dev/ttyACM0 --session scan-1 --report out\n\
        scans a die and writes out/report.html, out/scan.json and out/map.ply"
);
text!(
    ARTICLE_EXAMPLE: "Example:\n  flankscope scan --views 84x1 --speed max --session views\n  \
        flankscope article --scan views --report out\n\
        scans the demo die in one layer of 84 views and writes out/article.html\n\n  \
        flankscope article --write-settings settings.toml\n  \
        flankscope article --scan views --article-settings settings.toml --report out\n\
        uses the settings in settings.toml, for example with the denoising of the article's toolbox",
    "Example:\n  flankscope article --scan views --tool DIR --report out\n\
        computes the figures of a scan whose views are in the folder views (scan --session views) and writes out/article.html"
);
text!(
    WATCH_EXAMPLE: "Example:\n  flankscope watch --every 5 --cycles 40 --wear-rate 40:left:2 --speed 10\n\
        simulates a press that wears one flank by 2 um per cycle: go, then warn, then no-go",
    "Example:\n  flankscope watch --every 500 --tool DIR --link /dev/ttyACM0 --history press.db\n\
        checks the die every 500 cycles, with the press held during each check"
);
text!(
    HISTORY_EXAMPLE: "Example:\n  flankscope watch --every 5 --cycles 60 --wear-rate 40:left:0.8 --speed 10 --link sim --history bench.db\n  \
        flankscope history bench.db --report out\n\
        writes out/history.html with wear against cycles of every flank",
    "Example:\n  flankscope history press.db --report out\n\
        writes out/history.html with wear against cycles of every flank"
);
text!(
    COMPARE_EXAMPLE: "Example:\n  flankscope inspect --link sim --history bench.db\n  flankscope inspect --link sim --wear 40:left:20 --history bench.db\n  \
        flankscope compare bench.db 1 2 --page change.html\n\
        shows what was lost from the first check to the second",
    "Example:\n  flankscope compare press.db 12 40 --tool DIR --page change.html\n\
        shows what was lost from check 12 to check 40"
);
text!(
    REPLAY_EXAMPLE: "Example:\n  flankscope inspect --link sim --history bench.db\n  flankscope replay bench.db 1\n\
        recomputes the first check of the history",
    "Example:\n  flankscope replay press.db 1 --tool DIR\n\
        recomputes the first check of the history"
);
text!(
    DOCTOR: "Report what is installed, connected, calibrated and expired, with a remedy for every problem; nothing moves.\n\n\
        One line per item: its state (ok, attention, failed, not asked), its name, what was found, and after an arrow the \
        remedy. An item that needs attention still works today. With a real port everything that a check needs is examined; \
        without one, the simulated bench.",
    "Report what is installed, connected, calibrated and expired, with a remedy for every problem; nothing moves.\n\n\
        One line per item: its state (ok, attention, failed, not asked), its name, what was found, and after an arrow the \
        remedy. An item that needs attention still works today."
);
text!(
    /// Of the doctor's `--tool`.
    DOCTOR_TOOL: "Folder with tool.toml, and head.toml unless --head names one [default: the demo die, on the bench only]",
    "Folder with tool.toml, and head.toml unless --head names one"
);
text!(
    /// Of the patterns' `--head`.
    PATTERNS_HEAD: "Head file of the projector [default: the demo head]",
    "Head file of the projector"
);
text!(
    /// Ends of the paragraph on where a calibration starts.
    CALIBRATE_DEFAULT: " Without options the demo target on the simulated bench is used.",
    ""
);
text!(
    CALIBRATE_EXAMPLE: "Example:\n  flankscope calibrate --speed max -o head.toml\n  flankscope inspect --head head.toml\n\
        calibrates the demo head and checks the demo die with it\n\n  \
        flankscope calibrate --check head.toml\n\
        says whether the head is fit today\n\n  \
        flankscope bench demo-captures --out captures\n  \
        flankscope calibrate --target captures --images captures -o head.toml\n\
        calibrates from images",
    "Example:\n  flankscope calibrate --target DIR --link /dev/ttyACM0 -o head.toml\n\
        calibrates the head before a target that sits where the die does\n\n  \
        flankscope calibrate --check head.toml --target DIR --link /dev/ttyACM0\n\
        says whether the head is fit today\n\n  \
        flankscope calibrate --target DIR --images captures -o head.toml\n\
        calibrates from images"
);
