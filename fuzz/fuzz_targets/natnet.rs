//! NatNet datagrams as a server may send them: two, the first two bytes say where the first ends.
#![no_main]

use flyvine_link::mocap::natnet::Assembler;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let Some((&cut, datagrams)) = data.split_first_chunk() else {
        return;
    };
    let (first, second) = datagrams.split_at(usize::from(u16::from_le_bytes(cut)).min(datagrams.len()));
    let mut assembler = Assembler::default();
    let _ = assembler.receive(first);
    let _ = assembler.receive(second);
});
