//! Tests of `report.html`, and what holds of every page.

use super::sample;
use crate::report::html_report;

/// Every element that is opened is closed, in order.
pub(in crate::report) fn assert_balanced(page: &str) {
    const VOID: [&str; 3] = ["meta", "br", "!DOCTYPE"];
    let mut open: Vec<&str> = Vec::new();
    let mut rest = page;
    while let Some(start) = rest.find('<') {
        rest = &rest[start + 1..];
        let end = rest.find('>').expect("a closed tag");
        let tag = &rest[..end];
        let name = tag.trim_start_matches('/').split([' ', '/']).next().expect("a name");
        if name == "style" && !tag.starts_with('/') {
            rest = &rest[rest.find("</style>").expect("the end of the style sheet") + 8..];
            continue;
        }
        if tag.starts_with('/') {
            assert_eq!(open.pop(), Some(name), "before {}", &rest[..rest.len().min(80)]);
        } else if !tag.ends_with('/') && !VOID.contains(&name) {
            open.push(name);
        }
        rest = &rest[end + 1..];
    }
    assert!(open.is_empty(), "{open:?} stay open");
}

#[test]
fn pages_are_well_formed_and_fetch_nothing() {
    for outcome in [sample::simulated(), sample::measured(), sample::driven()] {
        let page = html_report(&outcome).expect("a page");
        assert_balanced(&page);
        for wrong in ["<script", "<link", "<img", "src=", "@import", "url(", "NaN", ">inf<", ">-inf<"] {
            assert!(!page.contains(wrong), "{wrong}");
        }
        let addresses = page.matches("http").count();
        assert_eq!(addresses, page.matches("http://www.w3.org/2000/svg").count(), "only the name of SVG");
        for (at, _) in page.match_indices("href=\"#") {
            let id = page[at + 7..].split('"').next().expect("an anchor");
            assert!(page.contains(&format!("id=\"{id}\"")), "{id}");
        }
    }
}

#[test]
fn no_string_of_a_user_reaches_the_page_as_it_is() {
    let page = html_report(&sample::measured()).expect("a page");
    assert!(!page.contains("alert(\"1\")"));
    let escaped = "&lt;script&gt;alert(&quot;1&quot;)&lt;/script&gt; &amp; 'co'";
    // Title, heading, registration, dropped pose, warning, file, and the command with its quotes quoted.
    assert!(page.matches(escaped).count() >= 6, "{}", page.matches(escaped).count());
    assert!(page.contains("calibrig identify --model '&lt;script&gt;"));
    assert!(page.contains("--measurements grid.csv"));
}

#[test]
fn the_tables_hold_the_numbers_in_mm_and_mrad() {
    let outcome = sample::simulated();
    let page = html_report(&outcome).expect("a page");
    for mode in &outcome.modes {
        for row in mode.rows.iter().flatten() {
            for metres in [row.max.x, row.mean.y, row.max.z, row.rms_3d, row.max_3d] {
                let cell = format!("{:.3}</td>", 1e3 * metres);
                assert!(page.contains(&cell), "{cell}");
            }
        }
    }
    assert!(page.contains(">26.2</td>"), "published");
    assert!(page.contains("\u{2212}17.1000</td>"), "true delta_theta4 in mrad");
    assert!(page.contains("calibrig run 'scenarios/spray painting.toml' --seed 42 --out DIR"));
}

#[test]
fn doubts_stand_in_front() {
    let page = html_report(&sample::measured()).expect("a page");
    let (doubt, summary) = (page.find("Doubtful."), page.find("id=\"summary\""));
    assert!(doubt.expect("a doubt") < summary.expect("a summary"));
    assert!(page.contains("delta_d6 (link 6, offset d) does the same as delta_d5"));
    assert!(!html_report(&sample::simulated()).expect("a page").contains("Doubtful."));
}
