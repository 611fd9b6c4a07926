//! Messages of Protocol Buffers with numbers and fields replaced where they stand, so that they still decode.

use std::ops::Range;

use super::choices::{Choices, EXTREMES};

/// What of a message can be replaced.
#[derive(Default)]
struct Layout {
    /// Numbers of eight bytes, by themselves or packed.
    numbers: Vec<usize>,
    /// Fields of the outermost message.
    fields: Vec<Range<usize>>,
}

/// A copy with a few of its numbers and fields replaced.
pub fn edited(message: &[u8], choices: &mut Choices<'_>) -> Vec<u8> {
    let mut message = message.to_vec();
    for _ in 0..=choices.below(4) {
        let mut layout = Layout::default();
        walk(&message, 0, true, &mut layout);
        let kind = choices.below(8);
        match kind {
            0..=3 if !layout.numbers.is_empty() => {
                let at = *choices.pick(&layout.numbers);
                let number = if choices.below(2) == 0 { *choices.pick(&EXTREMES) } else { choices.number() };
                message[at..at + 8].copy_from_slice(&number.to_le_bytes());
            }
            4 if !layout.fields.is_empty() => {
                let field = choices.pick(&layout.fields).clone();
                message.drain(field);
            }
            5 if !layout.fields.is_empty() => {
                let field = message[choices.pick(&layout.fields).clone()].to_vec();
                message.extend(field);
            }
            6 => message.truncate(choices.below(message.len() + 1)),
            _ if !message.is_empty() => {
                let at = choices.below(message.len());
                message[at] = *choices.pick(&[0, 1, 2, 0x7f, 0x80, 0xff]);
            }
            _ => {}
        }
    }
    message
}

/// Notes what is in the message at `start`; false where it is none.
fn walk(message: &[u8], start: usize, is_outermost: bool, layout: &mut Layout) -> bool {
    let mut at = 0;
    while at < message.len() {
        let begin = at;
        let Some(tag) = varint(message, &mut at) else { return false };
        let length = match tag & 7 {
            0 => varint(message, &mut at).map(|_| 0),
            1 => Some(8),
            2 => varint(message, &mut at).and_then(|length| usize::try_from(length).ok()),
            5 => Some(4),
            _ => None,
        };
        let end = length.and_then(|length| at.checked_add(length)).filter(|end| *end <= message.len());
        let (Some(end), true) = (end, tag >> 3 != 0) else { return false };
        if tag & 7 == 1 {
            layout.numbers.push(start + at);
        } else if tag & 7 == 2 {
            let mut within = Layout::default();
            if walk(&message[at..end], start + at, false, &mut within) {
                layout.numbers.extend(within.numbers);
            } else if (end - at).is_multiple_of(8) {
                layout.numbers.extend((at..end).step_by(8).map(|number| start + number));
            }
        }
        at = end;
        if is_outermost {
            layout.fields.push(begin..end);
        }
    }
    true
}

fn varint(message: &[u8], at: &mut usize) -> Option<u64> {
    let mut number = 0;
    for shift in 0..10 {
        let byte = *message.get(*at)?;
        *at += 1;
        number |= u64::from(byte & 0x7f) << (7 * shift).min(63);
        if byte < 0x80 {
            return Some(number);
        }
    }
    None
}
