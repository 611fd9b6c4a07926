use super::*;

fn columns() -> Vec<Column> {
    vec![
        Column::new("trial", Kind::Integer),
        Column::new("rms_m", Kind::Number),
        Column::new("reason", Kind::Text),
    ]
}

fn row(n: u32) -> Vec<Cell> {
    let number = (!n.is_multiple_of(3)).then(|| (f64::from(n) * 0.37).sin() * 1e-3);
    let reason =
        if n.is_multiple_of(7) { Cell::text(format!("no estimate, \"{n}\" µm")) } else { Cell::Absent };
    vec![Cell::Integer(n.into()), Cell::number(number), reason]
}

fn write(folder: &Path, name: &str, rows: u32) -> (PathBuf, String) {
    let mut writer = TableWriter::create(folder, &columns()).expect("a table");
    writer.say("calibrig.campaign", "{\"seed\":1}".to_owned());
    for n in 0..rows {
        writer.push(&row(n)).expect("a row");
    }
    let staged = writer.finish().expect("room");
    assert_eq!(staged.rows(), u64::from(rows));
    let (path, sum) = (folder.join(name), staged.sum().to_owned());
    staged.name(&path).expect("a name");
    (path, sum)
}

#[test]
fn rows_come_back_to_the_bit_over_several_groups() {
    let folder = tempfile::tempdir().expect("a folder");
    let count = u32::try_from(rows_a_group(3)).expect("some millions") + 10;
    let (path, _) = write(folder.path(), "t.parquet", count);
    let table = TableReader::open(&path).expect("a table");
    assert_eq!((table.rows(), table.columns()), (u64::from(count), &columns()[..]));
    assert_eq!(table.about("calibrig.campaign"), Some("{\"seed\":1}"));
    assert_eq!((table.place_of("reason"), table.place_of("else")), (Some(2), None));
    let mut n = 0;
    table
        .for_each_row::<TableError>(|cells| {
            assert_eq!(cells, row(n));
            n += 1;
            Ok(())
        })
        .expect("rows");
    assert_eq!(n, count);
    let middle = count - 15..count - 5;
    let mut picked = Vec::new();
    let rows = u64::from(middle.start)..u64::from(middle.end);
    table.visit(&[2, 0], rows.clone(), &mut |cells| picked.push(cells.to_vec())).expect("cells");
    let expected: Vec<_> = middle.clone().map(|n| [row(n)[2].clone(), row(n)[0].clone()]).collect();
    assert_eq!(picked, expected);
    let memory = MemoryTable::new(columns(), (0..count).map(row).collect());
    let mut same = Vec::new();
    memory.visit(&[2, 0], rows, &mut |cells| same.push(cells.to_vec())).expect("cells");
    assert_eq!((same, memory.rows()), (expected.iter().map(|row| row.to_vec()).collect(), table.rows()));
}

#[test]
fn the_same_rows_are_the_same_bytes_and_no_file_is_left_of_what_is_not_finished() {
    let folder = tempfile::tempdir().expect("a folder");
    let (one, first) = write(folder.path(), "one.parquet", 1000);
    let (two, second) = write(folder.path(), "two.parquet", 1000);
    let bytes = std::fs::read(&one).expect("a file");
    assert!(bytes == std::fs::read(&two).expect("a file") && first == second);
    // What is said of the file is of the file.
    use sha2::Digest;
    assert_eq!(write::hexadecimal(&sha2::Sha256::digest(&bytes)), first);
    let mut writer = TableWriter::create(folder.path(), &columns()).expect("a table");
    writer.push(&row(1)).expect("a row");
    drop(writer);
    assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 2);
}

#[test]
fn what_is_no_row_or_no_table_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut writer = TableWriter::create(folder.path(), &columns()).expect("a table");
    let short = writer.push(&row(1)[..2]).expect_err("two cells").to_string();
    assert!(short.contains("a row has 2 cells for 3 columns"), "{short}");
    let other = [Cell::Integer(1), Cell::Integer(2), Cell::Absent];
    assert!(writer.push(&other).is_err(), "an integer among numbers");
    let (path, _) = write(folder.path(), "t.parquet", 100);
    let bytes = std::fs::read(&path).expect("a file");
    for length in [0, 3, 4, 12, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(&path, &bytes[..length]).expect("room");
        assert!(TableReader::open(&path).is_err(), "{length} bytes of it");
    }
    let nowhere = folder.path().join("nowhere");
    assert!(matches!(TableWriter::create(&nowhere, &columns()), Err(TableError::Io { .. })));
}
