//! Passes the memory layout to the linker.

fn main() {
    board_build::pass_layout();
}
