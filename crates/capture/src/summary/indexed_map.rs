//! A map in the order of its keys whose entries keep a number: who adds to one again and again looks it up
//! once.

use std::collections::BTreeMap;
use std::ops::Index;

/// Values by key. A value keeps its number as long as the map exists.
#[derive(Clone, Debug)]
pub struct IndexedMap<K, V> {
    numbers: BTreeMap<K, usize>,
    values: Vec<V>,
}

impl<K, V> Default for IndexedMap<K, V> {
    fn default() -> Self {
        Self { numbers: BTreeMap::new(), values: Vec::new() }
    }
}

impl<K: Ord, V> IndexedMap<K, V> {
    /// Number of entries.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.values.len()
    }

    /// True without any.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// The value of a key.
    #[must_use]
    pub fn get(&self, key: &K) -> Option<&V> {
        self.numbers.get(key).map(|number| &self.values[*number])
    }

    /// Keys and values in the order of the keys.
    pub fn iter(&self) -> impl Iterator<Item = (&K, &V)> {
        self.numbers.iter().map(|(key, number)| (key, &self.values[*number]))
    }

    /// The keys in order.
    pub fn keys(&self) -> impl Iterator<Item = &K> {
        self.numbers.keys()
    }

    /// The number of a key, whose value is new if it has none yet; `None` if there would be more than `max`.
    pub(super) fn number(&mut self, key: K, max: usize) -> Option<usize>
    where
        V: Default,
    {
        if let Some(number) = self.numbers.get(&key) {
            return Some(*number);
        }
        (self.values.len() < max).then(|| {
            self.values.push(V::default());
            self.numbers.insert(key, self.values.len() - 1);
            self.values.len() - 1
        })
    }

    /// The value of a key, as [`number`](Self::number) gives it.
    pub(super) fn entry(&mut self, key: K, max: usize) -> Option<&mut V>
    where
        V: Default,
    {
        self.number(key, max).map(|number| &mut self.values[number])
    }

    /// The value with a number.
    pub(super) fn value_mut(&mut self, number: usize) -> &mut V {
        &mut self.values[number]
    }
}

impl<K: Ord, V> Index<&K> for IndexedMap<K, V> {
    type Output = V;

    fn index(&self, key: &K) -> &V {
        &self.values[self.numbers[key]]
    }
}
