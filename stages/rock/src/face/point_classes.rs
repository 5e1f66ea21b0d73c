//! Which points of a classified cloud are rock: classes as the ASPRS numbers them in LAS and LAZ files.

use std::collections::BTreeMap;

/// Classes that are left out where nobody says which to keep: low and high noise.
const NOISE: [u8; 2] = [7, 18];
/// Low, medium and high vegetation.
const VEGETATION: std::ops::RangeInclusive<u8> = 3..=5;
/// Names of classes (LAS 1.4, standard point classes), where they are of use for a face.
const NAMES: [(u8, &str); 12] = [
    (0, "never classified"),
    (1, "unclassified"),
    (2, "ground"),
    (3, "low vegetation"),
    (4, "medium vegetation"),
    (5, "high vegetation"),
    (6, "building"),
    (7, "low noise"),
    (9, "water"),
    (12, "overlap"),
    (17, "bridge"),
    (18, "high noise"),
];

/// What is wrong with a list of classes to keep, if anything is.
pub fn fault(listed: Option<&[u32]>) -> Option<String> {
    let class = listed?.iter().find(|class| **class > u32::from(u8::MAX))?;
    Some(format!("{class} is no class of LAS files, whose classes are 0 to 255"))
}

/// Whether points of a class are kept: those that are `listed`, or all but noise.
pub fn is_kept(listed: Option<&[u32]>, class: u8) -> bool {
    listed.map_or(!NOISE.contains(&class), |listed| listed.contains(&u32::from(class)))
}

/// Points that are left out for their class, of the numbers of points by class.
pub fn left_out(counts: &BTreeMap<u8, usize>, listed: Option<&[u32]>) -> usize {
    counts.iter().filter(|(class, _)| !is_kept(listed, **class)).map(|(_, count)| count).sum()
}

/// The numbers of points by class, in words; `None` where nothing is classified.
pub fn described(counts: &BTreeMap<u8, usize>, listed: Option<&[u32]>) -> Option<String> {
    if counts.keys().all(|class| *class == 0) && left_out(counts, listed) == 0 {
        return None;
    }
    let part = |(class, count): (&u8, &usize)| {
        let name =
            NAMES.iter().find(|(known, _)| known == class).map_or(String::new(), |(_, name)| format!(", {name}"));
        let fate = if is_kept(listed, *class) { "" } else { ": left out" };
        format!("{count} of class {class}{name}{fate}")
    };
    Some(counts.iter().map(part).collect::<Vec<String>>().join("; "))
}

/// What there is to say of vegetation that is taken for rock because nobody said which classes to keep.
pub fn vegetation(counts: &BTreeMap<u8, usize>, listed: Option<&[u32]>) -> Option<String> {
    let is_plant = |class: &u8| VEGETATION.contains(class);
    let plants: usize = counts.iter().filter(|(class, _)| is_plant(class)).map(|(_, count)| count).sum();
    if listed.is_some() || plants == 0 {
        return None;
    }
    let others: Vec<String> =
        counts.keys().filter(|class| is_kept(None, **class) && !is_plant(class)).map(u8::to_string).collect();
    let way = if others.is_empty() { "2".to_owned() } else { others.join(", ") };
    let all: usize = counts.values().sum();
    Some(format!(
        "{plants} of {all} points are classified as vegetation (classes 3 to 5) and are taken for rock: `classes: [{way}]` leaves them out, and \
         a list with 3 to 5 keeps them without this warning"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_goes_and_vegetation_is_warned_of_unless_classes_are_listed() {
        let counts = BTreeMap::from([(2, 90), (5, 9), (7, 2), (18, 1), (64, 3)]);
        assert_eq!((left_out(&counts, None), left_out(&counts, Some(&[2, 7]))), (3, 13));
        let text = described(&counts, None).unwrap();
        assert!(
            text.starts_with(
                "90 of class 2, ground; 9 of class 5, high vegetation; 2 of class 7, low noise: left out;"
            )
        );
        assert!(text.ends_with("3 of class 64"), "{text}");
        let warning = vegetation(&counts, None).unwrap();
        assert!(warning.starts_with("9 of 105 points") && warning.contains("`classes: [2, 64]`"), "{warning}");
        assert_eq!(vegetation(&counts, Some(&[2, 5])), None);
        assert_eq!(vegetation(&BTreeMap::from([(2, 90), (7, 1)]), None), None);
    }

    #[test]
    fn a_file_without_classes_is_taken_whole_and_says_nothing() {
        let counts = BTreeMap::from([(0, 10)]);
        assert_eq!((described(&counts, None), vegetation(&counts, None), left_out(&counts, None)), (None, None, 0));
        assert_eq!(described(&counts, Some(&[2])).unwrap(), "10 of class 0, never classified: left out");
    }
}
