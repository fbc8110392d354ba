pub struct Pair;
pub struct PairBuilder;
