//! How many characters each column of a text has, if numbers have nothing between them.

use std::path::Path;

/// Lines that are analysed.
const MOST_LINES: usize = 5000;
/// A longer file is not analysed.
const MOST_BYTES: u64 = 1 << 26;

/// A piece of a line, in characters from its begin.
#[derive(Clone, Copy)]
struct Piece {
    from: usize,
    to: usize,
    has_fraction: bool,
}

/// Widths at which the lines of a text can be cut: numbers with fractions end at the same place in every line.
pub(super) fn of_file(path: &Path) -> Option<Vec<usize>> {
    if std::fs::metadata(path).ok()?.len() > MOST_BYTES {
        return None;
    }
    of_text(&std::fs::read_to_string(path).ok()?)
}

fn of_text(text: &str) -> Option<Vec<usize>> {
    let is_row = |line: &&str| !line.trim().is_empty() && !line.starts_with(['#', '/']);
    let lines: Vec<Vec<Piece>> = text.lines().filter(is_row).take(MOST_LINES).map(pieces).collect();
    let fractions = |line: &Vec<Piece>| line.iter().filter(|piece| piece.has_fraction).count();
    let most = lines.iter().map(fractions).max().filter(|most| *most > 0)?;
    // If nothing at all is between two numbers, not even a sign, a line has fewer: its cut follows from the others.
    let whole: Vec<&Vec<Piece>> = lines.iter().filter(|line| fractions(line) == most).collect();
    let count = whole.first()?.len();
    if whole.len() < 2 || whole.iter().any(|line| line.len() != count) {
        return None;
    }
    let mut ends = Vec::new();
    for index in 0..count {
        let end = whole.iter().map(|line| line[index].to).max()?;
        let is_fixed = whole.iter().all(|line| !line[index].has_fraction || line[index].to == end);
        let is_free = index + 1 == count || whole.iter().all(|line| line[index + 1].from >= end);
        if !(is_fixed && is_free) {
            return None;
        }
        ends.push(end);
    }
    let starts = std::iter::once(0).chain(ends.iter().copied());
    Some(ends.iter().zip(starts).map(|(end, start)| end - start).collect())
}

/// What stands between blanks, and numbers with a sign behind other numbers or a name.
fn pieces(line: &str) -> Vec<Piece> {
    let letters: Vec<char> = line.chars().collect();
    let (mut pieces, mut from) = (Vec::new(), 0);
    let mut close = |from: usize, to: usize| {
        if from < to {
            let text: String = letters[from..to].iter().collect();
            let has_fraction = text.contains('.') && text.parse::<f64>().is_ok();
            pieces.push(Piece { from, to, has_fraction });
        }
    };
    for (at, letter) in letters.iter().enumerate() {
        let is_blank = letter.is_whitespace();
        if is_blank || (at > from && begins_number(&letters, at)) {
            close(from, at);
            from = at + usize::from(is_blank);
        }
    }
    close(from, letters.len());
    pieces
}

/// Whether a sign here comes after a digit or a letter, and in front of a number with a fraction.
fn begins_number(letters: &[char], at: usize) -> bool {
    let is_exponent = at > 1 && matches!(letters[at - 1], 'e' | 'E') && letters[at - 2].is_ascii_digit();
    let behind = &letters[at + 1..];
    let digits = behind.iter().take_while(|letter| letter.is_ascii_digit()).count();
    matches!(letters[at], '-' | '+')
        && !is_exponent
        && letters[at - 1].is_alphanumeric()
        && behind.get(digits) == Some(&'.')
}
