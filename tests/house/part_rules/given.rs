//! What goes into a use: inputs, parameters and axes.

use super::{FED, ONE, OVER, PLAIN, Rule, USED};

/// Inputs, parameters and axes: what goes into a use.
pub const GIVEN: &[Rule] = &[
    Rule {
        text: "every input that is not optional is fed",
        keeps: (FED, "u: {use: p, in: {a: e.out}}"),
        plans: "u/s",
        breaks: (FED, "u: {use: p}"),
        says: &["step `u` does not feed `a` (table), which part `p` reads @5:36; it is declared here @4:18"],
    },
    Rule {
        text: "an optional input may be left out",
        keeps: (
            "p: {in: {a: {kind: table, optional: true}}, out: {o: s.out}, steps: {s: {stage: toil, in: {after: in.a}}}}",
            "u: {use: p}",
        ),
        plans: "u/s",
        breaks: (
            "p: {in: {a: {kind: table, optional: true}}, out: {o: s.out}, steps: {s: {stage: add, in: {terms: in.a}}}}",
            "u: {use: p}",
        ),
        says: &["step `u/s` is not given its input `terms` (table) @4:89; = What is summed.; used here @5:27"],
    },
    Rule {
        text: "what is fed is an input of the part",
        keeps: (FED, "u: {use: p, in: {a: e.out}}"),
        plans: "u/s",
        breaks: (FED, "u: {use: p, in: {a: e.out, b: e.out}}"),
        says: &["part `p` has no input `b` @5:54; = did you mean `a`?"],
    },
    Rule {
        text: "what is fed is of a kind that the input takes",
        keeps: (
            "p: {in: {a: [mesh, table]}, out: {o: s.out}, steps: {s: {stage: add, in: {terms: in.a}}}}",
            "u: {use: p, in: {a: e.out}}",
        ),
        plans: "u/s",
        breaks: (
            "p: {in: {a: [mesh, surface]}, out: {o: s.out}, steps: {s: {stage: add, in: {terms: in.a}}}}",
            "u: {use: p, in: {a: e.out}}",
        ),
        says: &["part `p` takes a mesh or surface as `a`, but `e.out` is a table @5:47; it is declared here @4:18"],
    },
    Rule {
        text: "an input names kinds of artefact",
        keeps: (FED, "u: {use: p, in: {a: e.out}}"),
        plans: "u/s",
        breaks: (
            "p: {in: {a: tabel}, out: {o: s.out}, steps: {s: {stage: add, in: {terms: in.a}}}}",
            "u: {use: p, in: {a: e.out}}",
        ),
        says: &["unknown kind of artefact `tabel` @4:21; = did you mean `table`?"],
    },
    Rule {
        text: "an input that cannot be read is reported once",
        keeps: (FED, "u: {use: p, in: {a: e.out}}"),
        plans: "u/s",
        breaks: (FED, "u: {use: p, in: {a: e}}"),
        says: &[
            "`e` is not a reference to an output @5:47; = write step.port, or \"step.port[axis=item]\" in quotes for one point",
        ],
    },
    Rule {
        text: "an input takes all four forms",
        keeps: (FED, "d: {stage: draw, over: [k], in: {in: e.out}}, u: {use: p, in: {a: {each: d.out, over: [k]}}}"),
        plans: "d[k=0] d[k=1] u/s",
        breaks: (FED, "d: {stage: draw, over: [k], in: {in: e.out}}, u: {use: p, in: {a: {each: d.out}}}"),
        says: &["a gathered input needs `over` @5:93; = for example {each: noise.features, over: [replicate]}"],
    },
    Rule {
        text: "a part picks from an input that is one output",
        keeps: (
            "p: {in: {a: table}, out: {o: s.out}, axes: {i: {items: [x, y]}}, steps: {s: {stage: add, in: {terms: {by: i, x: in.a, y: in.a}}}}}",
            "u: {use: p, in: {a: e.out}}",
        ),
        plans: "u/s[i=x] u/s[i=y]",
        breaks: (
            "p: {in: {a: table}, out: {o: s.out}, axes: {i: {items: [x, y]}}, steps: {s: {stage: add, in: {terms: {by: i, x: in.a, y: in.a}}}}}",
            "d: {stage: draw, over: [k], in: {in: e.out}}, u: {use: p, in: {a: {each: d.out, over: [k]}}}",
        ),
        says: &[
            "part `p` chooses or gathers from `in.a`, which is a gathered list here @4:121; = give one output there: let a step before the use choose or gather; used here @5:73; it is given here @5:100",
        ],
    },
    Rule {
        text: "choosing by an axis whose items parameters say may name items it has for other values of theirs",
        keeps: (
            "p: {in: {a: table}, out: {o: s.out}, params: {w: {type: text}}, axes: {i: {values: ['${w}']}}, steps: {s: {stage: add, in: {terms: {by: i, x: in.a, y: in.a}}}}}",
            "u: {use: p, in: {a: e.out}, with: {w: y}}",
        ),
        plans: "u/s[i=y]",
        breaks: (
            "p: {in: {a: table}, out: {o: s.out}, params: {w: {type: text}}, axes: {i: {values: ['${w}']}}, steps: {s: {stage: add, in: {terms: {by: i, x: in.a, y: in.a}}}}}",
            "u: {use: p, in: {a: e.out}, with: {w: z}}",
        ),
        says: &[
            "choosing by `u/i` leaves out z @4:145; = say where the input comes from at every item, or add `else: step.port`; used here @5:27",
        ],
    },
    Rule {
        text: "a parameter of a part says its type",
        keeps: (ONE, USED),
        plans: "u/s",
        breaks: (
            "p: {params: {x: 3}, out: {o: s.out}, steps: {s: {stage: emit, with: {value: '${x}'}}}}",
            "u: {use: p}",
        ),
        says: &[
            "parameter `x` of a part does not say its type @4:22; = for example {type: number, min: 0, default: 0.7, doc: what it is}",
        ],
    },
    Rule {
        text: "the type of a parameter is one of eight",
        keeps: (ONE, USED),
        plans: "u/s",
        breaks: (
            "p: {params: {x: {type: nmber}}, out: {o: s.out}, steps: {s: {stage: emit, with: {value: '${x}'}}}}",
            "u: {use: p}",
        ),
        says: &["parameter `x` has the unknown type `nmber` @4:32; = did you mean `number`?"],
    },
    Rule {
        text: "a declaration has the keys type, unit, min, max, choices, default and doc",
        keeps: (
            "p: {params: {x: {type: number, unit: m, min: 0, max: 2, choices: [1, 2], default: 1, doc: Length.}}, out: {o: s.out}, steps: {s: {stage: emit, with: {value: '${x}'}}}}",
            "u: {use: p}",
        ),
        plans: "u/s",
        breaks: (
            "p: {params: {x: {type: number, units: m}}, out: {o: s.out}, steps: {s: {stage: emit, with: {value: '${x}'}}}}",
            "u: {use: p, with: {x: 1}}",
        ),
        says: &["unknown key `units` in parameter `x` @4:40; = did you mean `unit`?"],
    },
    Rule {
        text: "a parameter without a default is given",
        keeps: (ONE, USED),
        plans: "u/s",
        breaks: (ONE, "u: {use: p, in: {a: e.out}}"),
        says: &["step `u` does not say `x`, which part `p` needs @5:36; it is declared here @4:55"],
    },
    Rule {
        text: "a parameter with a default may be left out",
        keeps: (
            "p: {params: {x: {type: number, default: 1}}, out: {o: s.out}, steps: {s: {stage: emit, with: {value: '${x}'}}}}",
            "u: {use: p}",
        ),
        plans: "u/s",
        breaks: (
            "p: {params: {x: {type: number, default: one}}, out: {o: s.out}, steps: {s: {stage: emit, with: {value: '${x}'}}}}",
            "u: {use: p}",
        ),
        says: &["parameter `x` is a number, found `\"one\"` @4:49; `x` is declared here @4:22"],
    },
    Rule {
        text: "what is given is a parameter of the part",
        keeps: (ONE, USED),
        plans: "u/s",
        breaks: (ONE, "u: {use: p, in: {a: e.out}, with: {x: 1, y: 2}}"),
        says: &["part `p` has no parameter `y` @5:68; = did you mean `x`?"],
    },
    Rule {
        text: "what is given is of the type",
        keeps: (ONE, USED),
        plans: "u/s",
        breaks: (ONE, "u: {use: p, in: {a: e.out}, with: {x: word}}"),
        says: &["parameter `x` is a number, found `\"word\"` @5:65; `x` is declared here @4:55"],
    },
    Rule {
        text: "what is given is in the range",
        keeps: (ONE, USED),
        plans: "u/s",
        breaks: (ONE, "u: {use: p, in: {a: e.out}, with: {x: 4}}"),
        says: &["parameter `x` cannot be 4: at most 3 @5:65; `x` is declared here @4:55"],
    },
    Rule {
        text: "what is given is one of the choices",
        keeps: (
            "p: {params: {x: {type: number, choices: [1, 2]}}, out: {o: s.out}, steps: {s: {stage: emit, with: {value: '${x}'}}}}",
            "u: {use: p, with: {x: 2}}",
        ),
        plans: "u/s",
        breaks: (
            "p: {params: {x: {type: number, choices: [1, 2]}}, out: {o: s.out}, steps: {s: {stage: emit, with: {value: '${x}'}}}}",
            "u: {use: p, with: {x: 3}}",
        ),
        says: &["parameter `x` cannot be `3` @5:49; = one of: 1, 2; `x` is declared here @4:22"],
    },
    Rule {
        text: "a parameter of the pipeline is given by its name",
        keeps: (ONE, "u: {use: p, in: {a: e.out}, with: {x: '${two}'}}"),
        plans: "u/s",
        breaks: (ONE, "u: {use: p, in: {a: e.out}, with: {x: '${tow}'}}"),
        says: &["`${tow}` names neither a parameter nor an axis @5:65; = write $${tow} for the text itself"],
    },
    Rule {
        text: "an axis of the pipeline comes in by with",
        keeps: (ONE, "u: {use: p, in: {a: e.out}, with: {x: '${k}'}}"),
        plans: "u/s[k=0] u/s[k=1]",
        breaks: ("p: {out: {o: s.out}, steps: {s: {stage: emit, with: {value: '${k}'}}}}", "u: {use: p}"),
        says: &[
            "part `p` has neither a parameter nor an axis `k` @4:69; = write $${k} for the text itself; used here @5:27",
        ],
    },
    Rule {
        text: "an axis of the pipeline comes in by in",
        keeps: (FED, "d: {stage: draw, over: [k], in: {in: e.out}}, u: {use: p, in: {a: d.out}}"),
        plans: "d[k=0] d[k=1] u/s[k=0] u/s[k=1]",
        breaks: (FED, "d: {stage: draw, over: [k], in: {in: e.out}}, u: {use: p, in: {a: 'd.out[k=9]'}}"),
        says: &["`9` is no item of axis `k` @5:93; = did you mean `0`?"],
    },
    Rule {
        text: "an axis of the pipeline comes in by over",
        keeps: (PLAIN, "u: {use: p, over: [k]}"),
        plans: "u/s[k=0] u/s[k=1]",
        breaks: (PLAIN, "u: {use: p, over: [kk]}"),
        says: &["unknown axis `kk` @5:46; = did you mean `k`?"],
    },
    Rule {
        text: "a part names no axis of the pipeline",
        keeps: (PLAIN, "u: {use: p, over: [k]}"),
        plans: "u/s[k=0] u/s[k=1]",
        breaks: ("p: {out: {o: s.out}, steps: {s: {stage: emit, over: [k]}}}", "u: {use: p, over: [k]}"),
        says: &[
            "part `p` has no axis `k` @4:62; = axes of the pipeline come in by `in`, `with` and `over` of the use, and need no name here; used here @5:27",
        ],
    },
    Rule {
        text: "an axis of a part has a full name outside",
        keeps: (OVER, "u: {use: p}, v: {stage: add, in: {terms: 'u.o[u/i=1]'}}"),
        plans: "u/s[i=1] v",
        breaks: (OVER, "u: {use: p}, v: {stage: add, in: {terms: 'u.o[i=1]'}}"),
        says: &["unknown axis `i` @5:68; = known here: u/i"],
    },
    Rule {
        text: "an axis of a part has the keys of any axis",
        keeps: (OVER, "u: {use: p}"),
        plans: "u/s[i=0] u/s[i=1]",
        breaks: (
            "p: {out: {o: s.out}, axes: {i: {count: 2, reseed: false}}, steps: {s: {stage: emit, over: [i]}}}",
            "u: {use: p}",
        ),
        says: &["unknown key `reseed` in axis `u/i` @4:51; = did you mean `reseeds`?; used here @5:27"],
    },
    Rule {
        text: "axes of a part are walked together where its zip says so",
        keeps: (
            "p: {out: {o: s.out}, axes: {i: {count: 2}, j: {values: [5, 6]}}, zip: [i, j], steps: {s: {stage: emit, over: [i], with: {value: '${j}'}}}}",
            "u: {use: p}",
        ),
        plans: "u/s[i=0,j=5] u/s[i=1,j=6]",
        breaks: (
            "p: {out: {o: s.out}, axes: {i: {count: 2}, j: {values: [5, 6, 7]}}, zip: [i, j], steps: {s: {stage: emit, over: [i], with: {value: '${j}'}}}}",
            "u: {use: p}",
        ),
        says: &[
            "axis `u/j` has 3 items, `u/i` has 2 @4:86; = axes that are walked together have as many items as each other; used here @5:27",
        ],
    },
];
