// Read a bag as Foxglove does and print, per topic, its count and every message: node read_bag.mjs FILE.mcap
import { open } from "node:fs/promises";
import { McapIndexedReader } from "@mcap/core";
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import { decompress as zstd } from "fzstd";
import lz4 from "lz4js";

const file = await open(process.argv[2], "r");
const readable = {
  size: async () => BigInt((await file.stat()).size),
  read: async (offset, length) => {
    const buffer = new Uint8Array(Number(length));
    await file.read(buffer, 0, Number(length), Number(offset));
    return buffer;
  },
};
const decompressHandlers = {
  zstd: (data, size) => zstd(data, new Uint8Array(Number(size))),
  lz4: (data) => lz4.decompress(data),
};
const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
const decoders = new Map();
const topics = {};
for await (const message of reader.readMessages()) {
  const channel = reader.channelsById.get(message.channelId);
  let decoder = decoders.get(channel.id);
  if (decoder === undefined) {
    const schema = reader.schemasById.get(channel.schemaId);
    decoder = new MessageReader(parse(new TextDecoder().decode(schema.data), { ros2: true }));
    decoders.set(channel.id, decoder);
  }
  (topics[channel.topic] ??= []).push([message.logTime, decoder.readMessage(message.data)]);
}
const plain = (_, value) => {
  if (typeof value === "bigint") return value.toString();
  if (ArrayBuffer.isView(value)) return Array.from(value, (item) => plain(_, item));
  return typeof value === "number" && !Number.isFinite(value) ? String(value) : value;
};
console.log(JSON.stringify({ profile: reader.header.profile, topics }, plain));
