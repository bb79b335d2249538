// Reads a recording with @mcap/core and decodes it by the schemas it carries; prints counts and sums as JSON.
import { open } from "node:fs/promises";
import { McapIndexedReader } from "@mcap/core";
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import { decompress } from "fzstd";

const file = await open(process.argv[2], "r");
const readable = {
  size: async () => BigInt((await file.stat()).size),
  read: async (offset, length) => {
    const buffer = new Uint8Array(Number(length));
    await file.read(buffer, 0, buffer.length, Number(offset));
    return buffer;
  },
};
const reader = await McapIndexedReader.Initialize({
  readable,
  decompressHandlers: { zstd: (data, size) => decompress(data, new Uint8Array(Number(size))) },
});

const decoders = new Map();
for (const [id, channel] of reader.channelsById) {
  const schema = reader.schemasById.get(channel.schemaId);
  decoders.set(id, new MessageReader(parse(new TextDecoder().decode(schema.data), { ros2: true })));
}
const pick = {
  "/odom": (m) => m.pose.pose.position.x,
  "/command": (m) => m.twist.angular.z,
  "/feet": (m) => m.poses[3].position.z,
  "/joint_states": (m) => m.position[m.name.indexOf("FR_hip")],
  "/contact/RR": (m) => m.wrench.force.z,
};

const counts = {};
const sums = Object.fromEntries(Object.keys(pick).map((topic) => [topic, 0]));
let first;
let last;
for await (const message of reader.readMessages({ validateCrcs: true })) {
  const { topic } = reader.channelsById.get(message.channelId);
  counts[topic] = (counts[topic] ?? 0) + 1;
  first ??= message.logTime;
  last = message.logTime;
  if (topic in pick) {
    sums[topic] += pick[topic](decoders.get(message.channelId).readMessage(message.data));
  }
}
const metadata = {};
for await (const record of reader.readMetadata()) {
  metadata[record.name] = Object.fromEntries(record.metadata);
}
console.log(
  JSON.stringify({ profile: reader.header.profile, counts, sums, metadata, stamps: [String(first), String(last)] }),
);
