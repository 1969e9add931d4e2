// What a pass of the cascade on a target, a grid or the level, starts from. CPU reference: src/engine/stages/cascade.rs.

struct Coarser {
    int next;             // first cell of the dV that is stored, or -1: dV is 0. If joined: of the finest small grid
    int grids;            // if joined: grids between that one and the target
    int small_grids;      // grids in shared memory; 0 unless joined
    int coarsest_sweeps;  // relaxation sweeps on the coarsest grid
};
