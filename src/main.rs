//! The program `rockface`.

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() {
    rockface::memory::keep_freed_for_a_while();
    std::process::exit(rockface::program::run(rockface_stages::registry()));
}
