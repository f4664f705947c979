//! Words of Chinese programs in the character set of Windows there (GBK).

use std::borrow::Cow;

/// Words in GBK and as text, the longer first.
const WORDS: [(&[u8], &str); 30] = [
    (b"\xCF\xB5\xCD\xB3\xCA\xB1\xBC\xE4", "系统时间"),
    (b"\xCA\xB1\xBC\xE4\xB1\xEA\xCA\xB6", "时间标识"),
    (b"\xB4\xAB\xCA\xE4\xB7\xBD\xCF\xF2", "传输方向"),
    (b"\xCD\xA8\xB5\xC0", "通道"),
    (b"\xB7\xBD\xCF\xF2", "方向"),
    (b"\xD0\xF2\xBA\xC5", "序号"),
    (b"\xBA\xC5", "号"),
    (b"\xD6\xA1\xC0\xE0\xD0\xCD", "帧类型"),
    (b"\xD6\xA1\xB8\xF1\xCA\xBD", "帧格式"),
    (b"\xC0\xE0\xD0\xCD", "类型"),
    (b"\xB8\xF1\xCA\xBD", "格式"),
    (b"\xB3\xA4\xB6\xC8", "长度"),
    (b"\xCA\xFD\xBE\xDD\xD6\xA1", "数据帧"),
    (b"\xCA\xFD\xBE\xDD", "数据"),
    (b"\xB1\xEA\xD7\xBC\xD6\xA1", "标准帧"),
    (b"\xC0\xA9\xD5\xB9\xD6\xA1", "扩展帧"),
    (b"\xD4\xB6\xB3\xCC\xD6\xA1", "远程帧"),
    (b"\xB1\xEA\xD7\xBC", "标准"),
    (b"\xC0\xA9\xD5\xB9", "扩展"),
    (b"\xD4\xB6\xB3\xCC", "远程"),
    (b"\xBD\xD3\xCA\xD5", "接收"),
    (b"\xB7\xA2\xCB\xCD", "发送"),
    (b"\xB7\xA2", "发"),
    (b"\xCA\xD5", "收"),
    (b"\xD6\xA1", "帧"),
    (b"\xA1\xFA", "→"),
    (b"\xA1\xFB", "←"),
    (b"\xA1\xF3", "◇"),
    (b"\xA1\xF4", "◆"),
    (b"\xA1\xF5", "□"),
];

/// A line as text. Bytes that are neither UTF-8 nor one of the known words become replacement characters.
pub(super) fn decode(line: &[u8]) -> Cow<'_, str> {
    if let Ok(text) = std::str::from_utf8(line) {
        return Cow::Borrowed(text);
    }
    let (mut text, mut rest) = (String::with_capacity(line.len()), line);
    while let [first, after @ ..] = rest {
        let word = WORDS.iter().find(|(foreign, _)| rest.starts_with(foreign));
        rest = word.map_or(after, |(foreign, _)| &rest[foreign.len()..]);
        match word {
            Some((_, word)) => text.push_str(word),
            None if first.is_ascii() => text.push(char::from(*first)),
            None => text.push(char::REPLACEMENT_CHARACTER),
        }
    }
    Cow::Owned(text)
}
