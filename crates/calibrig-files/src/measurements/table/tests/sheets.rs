//! Sheets against what openpyxl and `rust_xlsxwriter` wrote, and by hand.

use super::*;

fn parsed(book: &mut Workbook, sheet: Option<&str>) -> Table {
    parse_sheet(&book.save_to_buffer().expect("written"), "book.xlsx", sheet).expect("read")
}

fn cells(table: &Table) -> Vec<(u32, Vec<&str>)> {
    let row = |row: &TableRow| match row.place {
        Place::Sheet { row, .. } => row,
        Place::Message { .. } | Place::Line(_) => panic!("of a sheet"),
    };
    table.rows.iter().map(|r| (row(r), r.cells.iter().map(String::as_str).collect())).collect()
}

#[test]
fn a_sheet_of_openpyxl_is_read_to_the_last_digit() {
    let table = sheet::read_sheet(&fixture("points.xlsx"), None).expect("read");
    assert_eq!(table.rows[0].cells, ["measured on a Tuesday"]);
    assert_eq!(table.rows[1].cells[..3], ["Pose", "shoulder_pan", "shoulder_lift"]);
    let sheet: std::sync::Arc<str> = "Points".into();
    assert_eq!(table.rows[1].place, Place::Sheet { sheet, row: 4, first_column: 2 });
    for (pose, row) in (0..POSES).zip(&table.rows[2..]) {
        assert_eq!(row.cells[0], (pose + 1).to_string());
        let row = TableRow { cells: row.cells[1..10].to_vec(), ..row.clone() };
        let degrees = (0..6).map(|number| joint(pose, number).to_degrees());
        assert_near(&numbers(&row), degrees.chain(place(pose).map(|axis| 1e3 * axis)));
    }
    let said = table.remarks.join("\n");
    for words in ["sheet Points is read; the others, Notes, are not", "Points!L6: a truth value"] {
        assert!(said.contains(words), "{words}: {said}");
    }
    let notes = sheet::read_sheet(&fixture("points.xlsx"), Some("Notes")).expect("read");
    assert_eq!((notes.rows.len(), notes.remarks.len()), (1, 0));
    let error = sheet::read_sheet(&fixture("points.xlsx"), Some("Pionts")).expect_err("refused");
    assert!(error.to_string().contains("there is no sheet Pionts"), "{error}");
}

#[test]
fn numbers_keep_every_bit() {
    let mut rng = stream(21, 0, Stream::Splits);
    let mut book = Workbook::new();
    let sheet = book.add_worksheet();
    let mut written = Vec::new();
    for row in 0..200 {
        let size = 10_f64.powi(rng.random_range(-12..15));
        let values: Vec<f64> = (0..5).map(|_| size * (rng.random::<f64>() - 0.5)).collect();
        for (column, value) in (0..).zip(&values) {
            sheet.write_number(row, column, *value).expect("written");
        }
        written.push(values);
    }
    let table = parsed(&mut book, None);
    for (row, values) in table.rows.iter().zip(&written) {
        let bits: Vec<u64> = numbers(row).iter().map(|value| value.to_bits()).collect();
        assert_eq!(bits, values.iter().map(|value| value.to_bits()).collect::<Vec<_>>());
    }
}

#[test]
fn what_is_no_number_is_a_text_and_told_with_its_cell() {
    let mut book = Workbook::new();
    book.add_worksheet().set_name("Log").expect("named");
    let sheet = book.add_worksheet().set_name("Run 2").expect("named");
    let date = Format::new().set_num_format("yyyy-mm-dd");
    let day = ExcelDateTime::parse_from_str("2026-11-29").expect("a day");
    sheet.write_string(0, 0, "X\n[mm]").expect("written");
    sheet.write_datetime_with_format(1, 0, &day, &date).expect("written");
    sheet.write_boolean(2, 0, true).expect("written");
    sheet.write_boolean(3, 0, false).expect("written");
    sheet.write_formula(4, 0, Formula::new("=1/0").set_result("#DIV/0!")).expect("written");
    sheet.write_formula(5, 0, Formula::new("=1+1").set_result("2")).expect("written");
    sheet.write_string(6, 1, "  ").expect("written");
    let table = parsed(&mut book, Some("Run 2"));
    let read = cells(&table);
    assert_eq!(read[0], (1, vec!["X [mm]"]));
    assert_eq!(read[1], (2, vec!["2026-11-29 00:00:00.000"]));
    assert_eq!((&read[2].1, &read[3].1), (&vec!["TRUE"], &vec!["FALSE"]));
    assert_eq!(read[5], (6, vec!["2"]));
    assert_eq!(read.len(), 6, "blanks are nothing");
    let said = table.remarks.join("\n");
    for words in ["Run 2!A2: a date", "Run 2!A3 and 1 cell more: a truth value"] {
        assert!(said.contains(words), "{words}: {said}");
    }
}

#[test]
fn merged_cells_hold_down_their_column_and_not_across() {
    let mut book = Workbook::new();
    let sheet = book.add_worksheet();
    let plain = Format::new();
    sheet.merge_range(0, 0, 1, 0, "Pose", &plain).expect("merged");
    sheet.merge_range(0, 1, 0, 3, "Position", &plain).expect("merged");
    for (column, name) in (1..).zip(["x", "y", "z"]) {
        sheet.write_string(1, column, name).expect("written");
    }
    sheet.merge_range(2, 0, 3, 0, "P1", &plain).expect("merged");
    for row in 2..4 {
        for column in 1..4 {
            sheet.write_number(row, column, f64::from(row)).expect("written");
        }
    }
    let table = parsed(&mut book, None);
    let read = cells(&table);
    assert_eq!(read[0].1, ["Pose", "Position"]);
    assert_eq!(read[1].1, ["Pose", "x", "y", "z"]);
    assert_eq!(read[3].1, ["P1", "3", "3", "3"]);
    let said = table.remarks.join("\n");
    assert!(said.contains("Sheet1!B1:D1: merged cells"), "{said}");
}

/// A spreadsheet by hand: parts of a ZIP archive that are not compressed.
fn zip(parts: &[(&str, &[u8])]) -> Vec<u8> {
    let (mut bytes, mut directory) = (Vec::new(), Vec::new());
    for (name, content) in parts {
        let at = u32::try_from(bytes.len()).expect("small");
        let size = u32::try_from(content.len()).expect("small").to_le_bytes();
        let length = u16::try_from(name.len()).expect("short").to_le_bytes();
        let middle = [
            &[20, 0, 0, 0, 0, 0, 0, 0, 0x21, 0][..],
            &crc32fast::hash(content).to_le_bytes(),
            &size,
            &size,
            &length,
            &[0; 2],
        ];
        bytes.extend([b"PK\x03\x04", middle.concat().as_slice(), name.as_bytes(), content].concat());
        directory.extend(
            [b"PK\x01\x02\x14\0", middle.concat().as_slice(), &[0; 10], &at.to_le_bytes(), name.as_bytes()]
                .concat(),
        );
    }
    let count = u16::try_from(parts.len()).expect("few").to_le_bytes();
    let (start, size) =
        (u32::try_from(bytes.len()).expect("small"), u32::try_from(directory.len()).expect("small"));
    bytes.extend(directory);
    bytes.extend(
        [b"PK\x05\x06\0\0\0\0", count.as_slice(), &count, &size.to_le_bytes(), &start.to_le_bytes(), &[0, 0]]
            .concat(),
    );
    bytes
}

const TYPES: &str = r#"<?xml version="1.0"?><Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types"><Default Extension="xml" ContentType="application/xml"/></Types>"#;
const RELATIONS: &str = r#"<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship Id="rId1" Type="http://schemas.openxmlformats.org/officeDocument/2006/relationships/worksheet" Target="worksheets/sheet1.xml"/></Relationships>"#;
const PARTS: &str = r#"<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship Id="rId1" Type="http://schemas.openxmlformats.org/officeDocument/2006/relationships/officeDocument" Target="xl/workbook.xml"/></Relationships>"#;
const BOOK: &str = r#"<workbook xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main" xmlns:r="http://schemas.openxmlformats.org/officeDocument/2006/relationships"><sheets><sheet name="S" sheetId="1" r:id="rId1"/></sheets></workbook>"#;
const SHEET: &str = r#"<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"><dimension ref="A1:D9"/><sheetData><row r="1"><c r="A1" t="inlineStr"><is><t>x</t></is></c><c r="B1" t="str"><v>y</v></c></row><row r="3"><c r="A3"><v>0.1</v></c><c r="B3"><f>A3*2</f></c><c r="C3" t="b"><v>1</v></c><c r="D3" t="e"><v>#N/A</v></c></row></sheetData><mergeCells count="1"><mergeCell ref="A3:A4"/></mergeCells></worksheet>"#;

fn by_hand(book: &[u8], sheet: &[u8]) -> Vec<u8> {
    zip(&[
        ("[Content_Types].xml", TYPES.as_bytes()),
        ("_rels/.rels", PARTS.as_bytes()),
        ("xl/workbook.xml", book),
        ("xl/_rels/workbook.xml.rels", RELATIONS.as_bytes()),
        ("xl/worksheets/sheet1.xml", sheet),
    ])
}

#[test]
fn a_formula_without_its_value_is_not_taken_for_an_empty_cell() {
    let table = parse_sheet(&by_hand(BOOK.as_bytes(), SHEET.as_bytes()), "b.xlsx", None).expect("read");
    assert_eq!(
        cells(&table),
        [(1, vec!["x", "y"]), (3, vec!["0.1", "formula without value", "TRUE", "#N/A"])]
    );
    let said = table.remarks.join("\n");
    assert!(said.contains("S!B3: a formula without its value") && said.contains("S!D3: an error"), "{said}");
}

#[test]
fn what_is_no_spreadsheet_is_refused_with_what_to_do() {
    let zipped = zip(&[("a.txt", b"hello")]);
    for bytes in
        [&b""[..], b"PK\x03\x04", b"x,y\n1,2\n", &zipped, &[0xd0, 0xcf, 0x11, 0xe0, 0xa1, 0xb1, 0x1a, 0xe1]]
    {
        let error = parse_sheet(bytes, "b.xlsx", None).expect_err("refused");
        assert!(error.contains("save"), "{error}");
    }
    // A cell where no sheet has one, and a range that a sheet cannot hold.
    let far = SHEET.replace("A3", "XFD1048576").replace("B3", "ZZZZZ99999999");
    assert!(parse_sheet(&by_hand(BOOK.as_bytes(), far.as_bytes()), "b.xlsx", None).is_err());
    let error = sheet::read_sheet(Path::new("no/such.xlsx"), None).expect_err("refused");
    assert!(error.to_string().contains("no/such.xlsx"), "{error}");
}

fn book() -> Vec<u8> {
    std::fs::read(fixture("points.xlsx")).expect("the fixture")
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(if std::env::var_os("CALIBRIG_FULL").is_some() { 20_000 } else { 400 }))]

    #[test]
    fn no_damaged_file_panics(bit in 0_usize..8 * 6900, cut in 0_usize..14_000) {
        let mut bytes = book();
        bytes[bit / 8] ^= 1 << (bit % 8);
        bytes.truncate(cut);
        let _ = parse_sheet(&bytes, "b.xlsx", None);
    }

    /// The archive is sound: what is in it is not.
    #[test]
    fn no_nonsense_in_a_sound_archive_panics(
        at in 0_usize..700, remove in 0_usize..30, insert in "\\PC{0,4}|[<>/\"=:A-Z0-9]{0,8}|99999999999|-1|NaN", of_book: bool,
    ) {
        let text = if of_book { BOOK } else { SHEET };
        let mut text: Vec<char> = text.chars().collect();
        let at = at.min(text.len());
        text.splice(at..(at + remove).min(text.len()), insert.chars());
        let text: String = text.into_iter().collect();
        let (book, sheet) = if of_book { (text.as_str(), SHEET) } else { (BOOK, text.as_str()) };
        if let Ok(table) = parse_sheet(&by_hand(book.as_bytes(), sheet.as_bytes()), "b.xlsx", None) {
            prop_assert!(table.rows.iter().all(|row| !row.cells.is_empty()));
        }
    }
}

/// A spreadsheet with another part in it, or in the place of one: `fill` writes what it unpacks to.
fn with_part(name: &str, fill: impl FnOnce(&mut dyn std::io::Write)) -> Vec<u8> {
    use std::io::Read;
    let mut book = Workbook::new();
    book.add_worksheet().write_string(0, 0, "X").expect("written");
    let mut whole =
        zip::ZipArchive::new(Cursor::new(book.save_to_buffer().expect("written"))).expect("an archive");
    let mut packed = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let options = zip::write::SimpleFileOptions::default();
    for index in 0..whole.len() {
        let mut part = whole.by_index(index).expect("a part");
        let known = part.name().expect("a name").into_owned();
        if known == name {
            continue;
        }
        let mut bytes = Vec::new();
        part.read_to_end(&mut bytes).expect("unpacked");
        packed.start_file(known.as_str(), options).expect("begun");
        std::io::Write::write_all(&mut packed, &bytes).expect("written");
    }
    packed.start_file(name, options).expect("begun");
    fill(&mut packed);
    packed.finish().expect("written").into_inner()
}

#[test]
fn what_unpacks_to_gigabytes_is_refused_before_it_is_kept() {
    let block = vec![b' '; 1 << 20];
    let bomb = with_part("xl/sharedStrings.xml", |part| {
        for _ in 0..257 {
            part.write_all(&block).expect("written");
        }
    });
    assert!(bomb.len() < 2 << 20);
    let refused = parse_sheet(&bomb, "book.xlsx", None).expect_err("a bomb");
    assert!(refused.contains("xl/sharedStrings.xml unpacks to more than 256 MiB"), "{refused}");
}

#[test]
fn one_long_text_in_many_cells_is_refused_at_its_cell() {
    let sheet = |cells: &str| {
        format!(
            "<?xml version=\"1.0\"?><worksheet xmlns=\"http://schemas.openxmlformats.org/spreadsheetml/2006/main\"><sheetData>{cells}</sheetData></worksheet>"
        )
    };
    let inline =
        |text: &str| format!("<row r=\"7\"><c r=\"B7\" t=\"inlineStr\"><is><t>{text}</t></is></c></row>");
    let book = with_part("xl/worksheets/sheet1.xml", |part| {
        part.write_all(sheet(&inline(&"x".repeat(200_000))).as_bytes()).expect("written");
    });
    let refused = parse_sheet(&book, "book.xlsx", None).expect_err("too long");
    assert!(refused.contains("cell B7") && refused.contains("32767 characters"), "{refused}");
    let book = with_part("xl/worksheets/sheet1.xml", |part| {
        part.write_all(sheet(&inline("1.5")).as_bytes()).expect("written");
    });
    assert_eq!(cells(&parse_sheet(&book, "book.xlsx", None).expect("read")), [(7, vec!["1.5"])]);
}

#[test]
fn cells_that_are_empty_at_the_end_of_a_row_are_not_missing() {
    let mut book = Workbook::new();
    let sheet = book.add_worksheet();
    for (column, name) in (0..).zip(["q1_rad", "x_m", "y_m", "z_m", "remark"]) {
        sheet.write_string(0, column, name).expect("written");
    }
    for row in 1..4 {
        for column in 0..4 {
            sheet.write_number(row, column, f64::from(row) + f64::from(column)).expect("written");
        }
    }
    sheet.write_string(2, 4, "touched").expect("written");
    let rows = Box::new(crate::MemoryRows::from(parsed(&mut book, None)));
    let joints = [calibrig_model::JointKind::Revolute];
    let loaded = crate::read_rows(rows, &crate::ColumnMap::default(), &joints).expect("read");
    assert_eq!(loaded.set.observations.len(), 3);
}

#[test]
fn dates_and_times_of_the_day_are_times() {
    let mut book = Workbook::new();
    let sheet = book.add_worksheet();
    for (column, name) in (0..).zip(["day", "clock", "j", "x", "y", "z"]) {
        sheet.write_string(0, column, name).expect("written");
    }
    let (date, time) = (Format::new().set_num_format("dd.mm.yyyy"), Format::new().set_num_format("hh:mm:ss"));
    let day = ExcelDateTime::parse_from_str("2026-05-04").expect("a day");
    let clock = ExcelDateTime::parse_from_str("10:15:30").expect("a time");
    sheet.write_datetime_with_format(1, 0, &day, &date).expect("written");
    sheet.write_datetime_with_format(1, 1, &clock, &time).expect("written");
    for column in 2..6 {
        sheet.write_number(1, column, f64::from(column)).expect("written");
    }
    let map = "schema = \"calibrig.columns/1\"\n[joints]\ncolumns = [\"j\"]\nrevolute_unit = \"rad\"\n[position]\nsystem = \"cartesian\"\n\
               unit = \"m\"\nx = \"x\"\ny = \"y\"\nz = \"z\"\n[columns]\ntime_s = [\"day\", \"clock\"]\n";
    let map = crate::parse_column_map(&crate::Source::new("map.toml", map)).expect("a map");
    let rows = Box::new(crate::MemoryRows::from(parsed(&mut book, None)));
    let loaded = crate::read_rows(rows, &map, &[calibrig_model::JointKind::Revolute]).expect("read");
    assert!(
        (loaded.set.observations[0].time - 1_777_889_730.0).abs() < 1e-3,
        "{:?}",
        loaded.set.observations[0].time
    );
}
