//! The program `rockface`.

/// Keeps what was freed for a moment, so that the large buffers of successive stages reuse it.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() {
    std::process::exit(rockface::program::run(rockface_stages::registry()));
}
